"""A stereo rig: two parallel cameras at a fixed distance from each other.

The frames of a rig come in pairs, left and right: 0 and 1, 2 and 3, ... The left cameras stand
where single views around a target would; each right one is the left one, moved along its own +x. So
a point of depth Z is seen on one row by both, f b / Z pixels further left by the right one.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ....core.errors import InputError
from ....core.geometry import make_transform

MAX_BASELINE = 0.3
"""Meters: no right camera touches the table then, however low and tilted the left one is."""


def check_stereo(views: int, baseline: float) -> None:
    """Checks the settings of a rig.

    Raises:
        InputError: if the frames do not make pairs, or the baseline is not above 0 and at most
            ``MAX_BASELINE`` meters.
    """
    if views < 2 or views % 2:
        raise InputError(f"views must be even with a stereo rig (left and right), got {views}")
    if not 0 < baseline <= MAX_BASELINE:
        raise InputError(
            f"stereo_baseline must be above 0 and at most {MAX_BASELINE} m, got {baseline}"
        )


def rig_frames(lefts: Iterable[np.ndarray], baseline: float) -> list[np.ndarray]:
    """T_cam_world (4, 4) of all frames, left and right alternating, from the left cameras'."""
    T_right_left = make_transform(np.eye(3), np.array([-baseline, 0.0, 0.0]))
    return [T for left in lefts for T in (left, T_right_left @ left)]


def rig_pairs(views: int) -> tuple[tuple[int, int], ...]:
    """Numbers of the left and the right frame of each pair."""
    return tuple((left, left + 1) for left in range(0, views, 2))
