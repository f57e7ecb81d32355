"""Errors of a relative camera pose, as from an inexact hand-eye calibration."""

import numpy as np
from scipy.spatial.transform import Rotation

from .geometry import make_transform


def perturb_relative_pose(
    T_second_ref: np.ndarray,
    degrees: float,
    meters: float,
    rng: np.random.Generator,
    *,
    uniform: bool = False,
) -> np.ndarray:
    """Rotates the second camera about its center and shifts it, both in random directions.

    Args:
        T_second_ref: relative pose (4, 4), from the reference camera's frame to the second's.
        degrees: angle of the rotation.
        meters: length of the shift.
        rng: random generator.
        uniform: draw angle and length uniformly from [0, ``degrees``] and [0, ``meters``].

    Returns:
        The perturbed relative pose (4, 4).
    """
    axis, direction = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    if uniform:
        degrees, meters = rng.uniform(0, degrees), rng.uniform(0, meters)
    rotation = Rotation.from_rotvec(axis * np.radians(degrees)).as_matrix()
    return make_transform(rotation, direction * meters) @ T_second_ref
