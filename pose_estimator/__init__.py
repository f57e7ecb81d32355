"""Two images in, one 6D object pose out.

``methods.py`` is the table of methods, ``fusion/`` holds their estimators, ``networks/`` and
``solvers/`` what these run. ``bop/`` reads and writes datasets; ``training/`` (with
``training_data/``), ``evaluation/``, ``study/`` and ``dataset_checks/`` are behind the commands.
:func:`load` gives an estimator with trained weights; torch is imported when it is called.
"""

from .fusion.loading import load
from .methods import METHODS

__all__ = ["METHODS", "load"]
