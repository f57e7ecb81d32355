"""Two pictures in, one pose out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .single_view import SingleViewEstimator

METHODS = ("single", "mid")
"""Names of the estimators that :func:`load` knows."""


def load(method: str = "mid", weights: str | Path = "linemod") -> SingleViewEstimator:
    """Loads an estimator with trained weights.

    Args:
        method: ``single`` (one view) or ``mid`` (Mid-Fusion of two views).
        weights: name of shipped weights, or a path to a ``.safetensors`` file.

    Returns:
        An object with ``estimate(views, object_name)`` and ``object_names``.

    Raises:
        ValueError: if the method is unknown or the weights are damaged.
        FileNotFoundError: if there are no such weights.
    """
    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}; there are {', '.join(METHODS)}")
    # These import torch, which the rest of the package must not do.
    from .mid_fusion import MidFusionEstimator
    from .single_view import SingleViewEstimator
    from .weights import load_networks

    estimators = {"single": SingleViewEstimator, "mid": MidFusionEstimator}
    return estimators[method](load_networks(weights))
