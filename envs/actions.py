"""Converts actions to viewpoints on the view sphere."""

from collections.abc import Sequence
from numbers import Integral
from typing import Any

import numpy as np

from ..core.errors import InputError
from .simulation.camera import CAMERA_RANGE

AZIMUTH_LIMIT = np.pi / 2
"""Maximum azimuth offset of the second view, radians."""


def box_view(action: Any) -> tuple[float, float, float]:
    """The view of a Box action (3,): azimuth offset (rad), elevation (rad), distance (m).

    Raises:
        InputError: if the action is NaN or not in the action space.
    """
    try:
        values = np.asarray(action, dtype=np.float32)
    except (TypeError, ValueError):
        values = np.empty(0, dtype=np.float32)
    if values.shape != (3,) or not (np.abs(values) <= 1.0).all():
        raise InputError(f"action must be three numbers from -1 to 1, got {action!r}")
    azimuth, elevation, distance = values.astype(np.float64)
    return (
        float(azimuth * AZIMUTH_LIMIT),
        _between(CAMERA_RANGE.elevation, elevation),
        _between(CAMERA_RANGE.distance, distance),
    )


def candidate_view(action: Any, count: int) -> int:
    """Validates a Discrete action: an integer, or an array of shape ().

    Raises:
        InputError: if it is not an integer from 0 to ``count`` - 1.
    """
    if isinstance(action, np.ndarray) and action.ndim == 0:
        action = action.item()
    integer = isinstance(action, Integral) and not isinstance(action, bool)
    if not integer or not 0 <= int(action) < count:
        raise InputError(f"action must be an integer from 0 to {count - 1}, got {action!r}")
    return int(action)


def check_candidates(candidates: Sequence[tuple[float, float]]) -> np.ndarray:
    """Candidate views in radians, (N, 2).

    Raises:
        InputError: if they are not pairs (azimuth offset, elevation) within the range, degrees.
    """
    views = np.asarray(candidates, dtype=np.float64)
    low, high = np.rad2deg(CAMERA_RANGE.elevation)
    pairs = views.ndim == 2 and views.shape[0] > 0 and views.shape[1] == 2
    bounds = (-180, low - 1e-9), (180, high + 1e-9)
    if not pairs or not ((bounds[0] <= views) & (views <= bounds[1])).all():
        raise InputError(
            "candidate_views must be pairs of azimuth offset (-180 to 180 degrees) and elevation "
            f"({low:.0f} to {high:.0f} degrees), got {candidates!r}"
        )
    return np.deg2rad(views)


def _between(limits: tuple[float, float], value: float) -> float:
    """Maps -1 to 1 linearly onto the limits."""
    low, high = limits
    return float(low + (value + 1.0) / 2.0 * (high - low))
