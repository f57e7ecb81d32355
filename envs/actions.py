"""What an action means: where on the view sphere it sends the camera."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral
from typing import Any

import numpy as np

from ..core.errors import InputError
from .simulation.camera import CAMERA_RANGE

AZIMUTH_LIMIT = np.pi / 2
"""Largest azimuth offset of the second view to either side, radians."""


def box_view(action: Any) -> tuple[float, float, float]:
    """The view of a Box action: azimuth offset (rad), elevation (rad), distance (m).

    Args:
        action: (3,) numbers from -1 to 1.

    Raises:
        InputError: if the action is NaN or not in the action space.
    """
    try:
        values = np.asarray(action, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise InputError(f"action must be three numbers from -1 to 1, got {action!r}") from error
    if values.shape != (3,) or not (np.abs(values) <= 1.0).all():
        raise InputError(f"action must be three numbers from -1 to 1, got {action!r}")
    azimuth, elevation, distance = values.astype(np.float64)
    return (
        float(azimuth * AZIMUTH_LIMIT),
        _between(CAMERA_RANGE.elevation, elevation),
        _between(CAMERA_RANGE.distance, distance),
    )


def candidate_view(action: Any, count: int) -> int:
    """The number of a candidate view that a Discrete action is.

    Args:
        action: an integer, also as an array without axes.
        count: how many candidates there are.

    Raises:
        InputError: if it is no integer from 0 to ``count`` - 1.
    """
    if isinstance(action, np.ndarray) and action.ndim == 0:
        action = action.item()
    whole = isinstance(action, Integral) and not isinstance(action, bool)
    if not whole or not 0 <= int(action) < count:
        raise InputError(f"action must be an integer from 0 to {count - 1}, got {action!r}")
    return int(action)


def check_candidates(candidates: Sequence[tuple[float, float]]) -> np.ndarray:
    """Candidate views in radians, (N, 2).

    Raises:
        InputError: if they are no list of (azimuth offset, elevation) in degrees within the range.
    """
    views = np.asarray(candidates, dtype=np.float64)
    low, high = np.rad2deg(CAMERA_RANGE.elevation)
    valid = views.ndim == 2 and views.shape[0] > 0 and views.shape[1] == 2
    if valid:
        valid = bool((np.abs(views[:, 0]) <= 180).all())
        valid &= bool(((views[:, 1] >= low - 1e-9) & (views[:, 1] <= high + 1e-9)).all())
    if not valid:
        raise InputError(
            "candidate_views must be pairs of azimuth offset (-180 to 180 degrees) and elevation "
            f"({low:.0f} to {high:.0f} degrees), got {candidates!r}"
        )
    return np.deg2rad(views)


def _between(limits: tuple[float, float], value: float) -> float:
    """Maps -1 to 1 linearly onto the limits."""
    low, high = limits
    return float(low + (value + 1.0) / 2.0 * (high - low))
