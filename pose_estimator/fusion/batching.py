"""Batches of requests to any estimator, with or without ``estimate_batch``."""

from collections.abc import Sequence
from typing import Any

from ...core.geometry import View
from ..types import PoseEstimate, Roi

_BATCH = 8
"""For an estimator with ``estimate_batch`` and without a ``batch_size``."""


def estimate_all(
    estimator: Any,
    requests: Sequence[tuple[Sequence[View], str]],
    rois: Sequence[Sequence[Roi]] | None = None,
) -> list[PoseEstimate]:
    """Estimates each request, in one batch if the estimator can.

    Args:
        estimator: has ``estimate``, and perhaps ``estimate_batch``.
        requests: views, the reference first, and the object's name.
        rois: regions of interest of each request's views, instead of the detector's.
    """
    given = () if rois is None else (list(rois),)
    batch = getattr(estimator, "estimate_batch", None)
    if batch is not None:
        return list(batch(list(requests), *given))
    each = [()] * len(requests) if rois is None else [(own,) for own in rois]
    return [
        estimator.estimate(views, name, *own)
        for (views, name), own in zip(requests, each, strict=True)
    ]


def batch_size(estimator: Any) -> int:
    """Returns the estimator's own batch size, else 8 with ``estimate_batch`` and 1 without."""
    default = _BATCH if hasattr(estimator, "estimate_batch") else 1
    return int(getattr(estimator, "batch_size", default))
