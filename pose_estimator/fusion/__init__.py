"""The estimators, one method a file: ``single``, ``early``, ``late``, ``mid`` and ``rgbd``.

``frontend.py`` detects and encodes views, ``two_view.py`` is the base class of the fusions,
``symmetry_agreement.py`` makes views of symmetric objects consistent, ``loading.py`` loads an
estimator with its weights, and ``estimate_files.py`` is the command ``estimate``.
"""
