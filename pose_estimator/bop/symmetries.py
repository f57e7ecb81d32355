"""Symmetries of an object as transforms: continuous ones are discretized, and recognized again.

A rotation about each continuous axis is a symmetry, and so is each product of symmetries. Of a
bounded object only three such groups have a continuous axis: rotations about that axis (a cone),
these and a half turn that reverses the axis (a cylinder), and all rotations about a point (a
sphere). All three are discretized to a bounded number of transforms.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from ...core.geometry import invert, transform

CONTINUOUS_SYMMETRY_STEPS = 72
"""Rotations that discretize a continuous symmetry."""

SPHERE_ROTATIONS = 1000
"""Rotations that discretize those of a sphere: about 15 degrees from one to the next."""

MIN_AXIS_LENGTH = 1e-6
"""A shorter direction is none."""

SAME_AXIS = np.radians(5.0)
"""Directions that differ by less are the same, in radians."""

MEETING = 1e-3
"""Axes that pass each other at a smaller distance meet, in meters."""


def all_symmetries(discrete: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Returns the symmetry transforms that an entry of ``models_info.json`` describes.

    Args:
        discrete: (D, 4, 4) discrete symmetries without the identity, meters.
        axes: (C, 6) continuous symmetries: direction and a point on the axis in meters. A direction
            of NaN or of length zero is none.

    Returns:
        (S, 4, 4), identity first. Discrete symmetries without an axis are returned as they are.
    """
    axes = axes[np.linalg.norm(axes[:, :3], axis=1) > MIN_AXIS_LENGTH]  # false for NaN
    if not len(axes):
        return np.concatenate([np.eye(4)[None], discrete])
    direction = axes[0, :3] / np.linalg.norm(axes[0, :3])
    point = axes[0, 3:]
    others = [*axes[1:, :3], *(T[:3, :3] @ direction for T in discrete)]
    tilted = next((other for other in others if _angle(direction, other) > SAME_AXIS), None)
    if tilted is not None:
        return _about(_sphere_rotations(), _center(axes, discrete))
    angles = np.arange(CONTINUOUS_SYMMETRY_STEPS) * (2 * np.pi / CONTINUOUS_SYMMETRY_STEPS)
    turns = _about(Rotation.from_rotvec(angles[:, None] * direction), point)
    flip = next((T for T in discrete if direction @ T[:3, :3] @ direction < 0), None)
    return turns if flip is None else np.concatenate([turns, flip @ turns])


def axes_meet(axes: np.ndarray) -> bool:
    """Whether axes (C, 6), as in `all_symmetries`, are one line or meet in one point.

    Other axes would together move the object away, which no bounded object allows.
    """
    axes = axes[np.linalg.norm(axes[:, :3], axis=1) > MIN_AXIS_LENGTH]
    return not len(axes) or bool(_distances(axes, _meeting_point(axes)).max() < MEETING)


def split_continuous(symmetries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns discrete and continuous symmetries: the inverse of `all_symmetries`.

    Args:
        symmetries: (S, 4, 4), identity first.

    Returns:
        Discrete symmetries without the identity, (D, 4, 4), and axes, (C, 6).
    """
    others = symmetries[1:]
    if len(others) + 1 == SPHERE_ROTATIONS and np.allclose(
        symmetries[:, :3, :3], _sphere_rotations().as_matrix(), atol=1e-6
    ):
        points = np.tile(_fixed_point(others), (3, 1))
        return np.empty((0, 4, 4)), np.concatenate([np.eye(3), points], axis=1)
    vectors = Rotation.from_matrix(symmetries[:, :3, :3]).as_rotvec()
    step = 2 * np.pi / CONTINUOUS_SYMMETRY_STEPS
    lengths = np.linalg.norm(vectors, axis=1)
    for first in np.flatnonzero(np.abs(lengths - step) < 1e-4).tolist():
        direction = vectors[first] / lengths[first]
        around = np.linalg.norm(np.cross(vectors, direction), axis=1) < 1e-4
        if around.sum() < CONTINUOUS_SYMMETRY_STEPS:
            continue
        point = _fixed_point(symmetries[around & (lengths > 1e-4)])
        axis = np.concatenate([direction, point])[None]
        flips = symmetries[symmetries[:, :3, :3] @ direction @ direction < -0.5][:1]
        expected = all_symmetries(flips, axis)
        if len(expected) == len(symmetries) and _same_set(expected, symmetries):
            return flips, axis
    return others, np.empty((0, 6))


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the angle between two lines, radians."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(a @ b)))


def _center(axes: np.ndarray, discrete: np.ndarray) -> np.ndarray:
    """Returns the point that all symmetries of a sphere leave where it is."""
    moved = [
        np.concatenate([T[:3, :3] @ axis[:3], transform(T, axis[3:])])
        for T in discrete
        for axis in axes
    ]
    return _meeting_point(np.stack([*axes, *moved]))


def _meeting_point(axes: np.ndarray) -> np.ndarray:
    """Returns the point nearest to all axes (C, 6) by least squares."""
    across = np.eye(3) - np.einsum("ni,nj->nij", *[_unit(axes[:, :3])] * 2)
    target = np.einsum("nij,nj->i", across, axes[:, 3:])
    return np.linalg.lstsq(across.sum(axis=0), target, rcond=1e-9)[0]


def _distances(axes: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Returns the distances of a point from axes (C, 6)."""
    return np.linalg.norm(np.cross(_unit(axes[:, :3]), point - axes[:, 3:]), axis=1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _fixed_point(turns: np.ndarray) -> np.ndarray:
    """Returns the point nearest to the origin that rotations (N, 4, 4) leave where it is."""
    rows = (np.eye(3) - turns[:, :3, :3]).reshape(-1, 3)
    return np.linalg.lstsq(rows, turns[:, :3, 3].ravel(), rcond=1e-6)[0]


def _about(rotations: Rotation, point: np.ndarray) -> np.ndarray:
    """Returns rotations about a point as (N, 4, 4)."""
    T = np.tile(np.eye(4), (len(rotations), 1, 1))
    T[:, :3, :3] = rotations.as_matrix()
    T[:, :3, 3] = point - T[:, :3, :3] @ point
    return T


def _sphere_rotations() -> Rotation:
    """Returns evenly spread rotations, the identity first.

    Alexa, "Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3)", CVPR 2022.
    """
    s = np.arange(SPHERE_ROTATIONS) + 0.5
    inner, outer = np.sqrt(s / SPHERE_ROTATIONS), np.sqrt(1 - s / SPHERE_ROTATIONS)
    alpha, beta = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    parts = inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)
    rotations = Rotation.from_quat(np.stack(parts, axis=1))
    return rotations * rotations[0].inv()


def _same_set(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether each transform of a (N, 4, 4) is one of b (N, 4, 4)."""
    return all(np.abs(invert(T) @ b - np.eye(4)).max(axis=(1, 2)).min() < 1e-5 for T in a)
