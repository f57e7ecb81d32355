"""A rectified stereo rig: two parallel cameras at a fixed baseline.

Frames alternate left and right: 0 and 1, 2 and 3, ... Each right camera is the left one moved along
its own +x. A point of depth Z is in the same row of both images; its disparity is f b / Z pixels.
"""

from collections.abc import Iterable

import numpy as np

from ....core.errors import InputError
from ....core.geometry import make_transform

MAX_BASELINE = 0.3
"""Meters: up to it, no right camera collides with the table."""


def check_stereo(views: int, baseline: float) -> None:
    """Raises an InputError if ``views`` is odd or the baseline not in (0, ``MAX_BASELINE``]."""
    if views < 2 or views % 2:
        raise InputError(f"views must be even with a stereo rig (left and right), got {views}")
    if not 0 < baseline <= MAX_BASELINE:
        raise InputError(f"stereo_baseline must be > 0 and <= {MAX_BASELINE} m, got {baseline}")


def rig_frames(lefts: Iterable[np.ndarray], baseline: float) -> list[np.ndarray]:
    """Returns T_cam_world (4, 4) of all frames, left and right alternating."""
    T_right_left = make_transform(np.eye(3), np.array([-baseline, 0.0, 0.0]))
    return [T for left in lefts for T in (left, T_right_left @ left)]


def rig_pairs(views: int) -> tuple[tuple[int, int], ...]:
    """Returns the numbers of the left and right frame of each pair."""
    return tuple((left, left + 1) for left in range(0, views, 2))
