"""Several estimates at once, of any estimator: ours answer batches, others one by one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...core.geometry import View
from ..types import PoseEstimate, Roi

_BATCH = 8
"""Requests for an estimator that answers batches and does not say how large."""


def estimate_all(
    estimator: Any,
    requests: Sequence[tuple[Sequence[View], str]],
    rois: Sequence[Sequence[Roi]] | None = None,
) -> list[PoseEstimate]:
    """The answer to each of several requests: all at once if the estimator can.

    Args:
        estimator: has ``estimate``, and perhaps ``estimate_batch``.
        requests: views, the reference first, and the name of the object to look for.
        rois: regions of each request's views, instead of where a detector would look.
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
    """How many requests an estimator wants at once: as many as it says, else 8, or 1 by 1."""
    return int(
        getattr(estimator, "batch_size", _BATCH if hasattr(estimator, "estimate_batch") else 1)
    )
