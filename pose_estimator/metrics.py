"""How far an estimated pose is from the true one.

ADD is Hinterstoisser et al., ACCV 2012 (equation 4); ADD-S, for symmetric objects, is its nearest
point form (equation 5), with the argument order of the BOP toolkit. A pose counts as correct when
the error is below a tenth of the object's diameter.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..assets.object_model import ObjectModel
from .geometry import check_rigid, invert, transform
from .nearest_points import NearestPoints


class MeasuredObject(Protocol):
    """What ADD(-S) asks of an object.

    Attributes:
        name: what it is called.
        points: (P, 3) in its own frame, metres.
        diameter: metres.
        symmetric: whether ADD-S is the measure.
    """

    @property
    def name(self) -> str: ...
    @property
    def points(self) -> np.ndarray: ...
    @property
    def diameter(self) -> float: ...
    @property
    def symmetric(self) -> bool: ...
    def __hash__(self) -> int: ...


def add(T_est: np.ndarray, T_true: np.ndarray, points: np.ndarray) -> float:
    """Mean distance between the points under the two poses (ADD).

    Args:
        T_est: estimated T_cam_obj, (4, 4).
        T_true: true T_cam_obj, (4, 4).
        points: model points in the object's frame, (P, 3), metres.

    Returns:
        ADD in metres.

    Raises:
        ValueError: if a pose is not rigid or the points are not (P, 3) with P > 0.
    """
    T_est, T_true = _check_poses(T_est, T_true)
    points = _check_points(points)
    return float(_distances(transform(T_est, points), transform(T_true, points)).mean())


def add_s(
    T_est: np.ndarray,
    T_true: np.ndarray,
    points: np.ndarray,
    *,
    tree: NearestPoints | cKDTree | None = None,
) -> float:
    """Mean distance from each point under the true pose to the nearest under the estimate (ADD-S).

    Args:
        T_est: estimated T_cam_obj, (4, 4).
        T_true: true T_cam_obj, (4, 4).
        points: model points in the object's frame, (P, 3), metres.
        tree: an index of ``points``, if the caller keeps one; :class:`NearestPoints` is quickest.

    Returns:
        ADD-S in metres.

    Raises:
        ValueError: if a pose is not rigid or the points are not (P, 3) with P > 0.
    """
    T_est, T_true = _check_poses(T_est, T_true)
    points = _check_points(points)
    # Distances do not change under a rigid motion, so the search runs in the object's own frame
    # (of the estimate), where one index serves every pose.
    motion = invert(T_est) @ T_true
    if isinstance(tree, cKDTree):
        return float(tree.query(transform(motion, points))[0].mean())
    return (NearestPoints(points) if tree is None else tree).mean_distance(motion)


def add_or_add_s(T_est: np.ndarray, T_true: np.ndarray, object_model: MeasuredObject) -> float:
    """ADD(-S): ADD-S for a symmetric object and ADD for any other, in metres.

    Args:
        T_est: estimated T_cam_obj, (4, 4).
        T_true: true T_cam_obj, (4, 4).
        object_model: the object; its ``points`` are measured.

    Raises:
        ValueError: if a pose is not rigid, or the object's surface is not known.
    """
    if not len(object_model.points):
        raise ValueError(
            f"the surface of {object_model.name} is not stored with the weights, and ADD is taken "
            "on it: use the object of a mesh file, or a dataset that has models"
        )
    if object_model.symmetric:
        return add_s(T_est, T_true, object_model.points, tree=_surface_index(object_model))
    return add(T_est, T_true, object_model.points)


def nearest_symmetric_pose(
    T_est: np.ndarray, T_true: np.ndarray, object_model: ObjectModel
) -> np.ndarray:
    """The symmetry-equivalent of ``T_true`` whose keypoints are nearest to the estimate's, (4, 4).

    Raises:
        ValueError: if a pose is not rigid.
    """
    T_est, T_true = _check_poses(T_est, T_true)
    candidates = T_true @ object_model.symmetries
    estimated = transform(T_est, object_model.keypoints)
    errors = [
        _distances(estimated, transform(T, object_model.keypoints)).mean() for T in candidates
    ]
    return candidates[int(np.argmin(errors))]


def keypoint_distance(T_est: np.ndarray, T_true: np.ndarray, object_model: ObjectModel) -> float:
    """Mean distance between the keypoints under the two poses, in metres.

    Of the poses that are equivalent to ``T_true`` under the object's symmetries, the one nearest to
    the estimate counts.

    Raises:
        ValueError: if a pose is not rigid.
    """
    T_nearest = nearest_symmetric_pose(T_est, T_true, object_model)
    return add(T_est, T_nearest, object_model.keypoints)


def rotation_error(
    T_est: np.ndarray, T_true: np.ndarray, symmetries: np.ndarray | None = None
) -> float:
    """Angle between the two rotations in radians, the least over the symmetries (S, 4, 4).

    Raises:
        ValueError: if a pose is not rigid.
    """
    T_est, T_true = _check_poses(T_est, T_true)
    symmetries = np.eye(4)[None] if symmetries is None else np.asarray(symmetries, dtype=float)
    relative = T_est[:3, :3].T @ T_true[:3, :3] @ symmetries[:, :3, :3]
    return float(Rotation.from_matrix(relative).magnitude().min())


def translation_error(
    T_est: np.ndarray, T_true: np.ndarray, symmetries: np.ndarray | None = None
) -> float:
    """Distance between the two object origins in metres.

    With ``symmetries`` (S, 4, 4) the true pose is the equivalent of least rotation error, so that
    both errors speak of the same one.

    Raises:
        ValueError: if a pose is not rigid.
    """
    T_est, T_true = _check_poses(T_est, T_true)
    if symmetries is not None:
        candidates = T_true @ np.asarray(symmetries, dtype=float)
        angles = [rotation_error(T_est, T) for T in candidates]
        T_true = candidates[int(np.argmin(angles))]
    return float(np.linalg.norm(T_est[:3, 3] - T_true[:3, 3]))


def recall(errors: np.ndarray, diameters: np.ndarray | float, threshold: float = 0.1) -> float:
    """Share of the errors that are below ``threshold`` diameters, 0 to 1.

    Args:
        errors: ADD(-S) of each estimate, (N,), metres; infinite where there was no estimate.
        diameters: diameter of each estimate's object, (N,), or one for all, metres.
        threshold: in diameters.

    Raises:
        ValueError: if there are no errors, one is NaN, or the shapes do not match.
    """
    errors = np.asarray(errors, dtype=np.float64)
    if errors.ndim != 1 or errors.size == 0:
        raise ValueError(f"errors must be a non-empty list of numbers, got shape {errors.shape}")
    if np.isnan(errors).any():
        raise ValueError("errors has NaN entries; use inf where there was no estimate")
    diameters = np.asarray(diameters, dtype=np.float64)
    if diameters.shape not in ((), errors.shape):
        raise ValueError(
            f"diameters must be one number or one for each of the {errors.size} errors, "
            f"got shape {diameters.shape}"
        )
    return float((errors < threshold * diameters).mean())


def bootstrap_interval(
    values: np.ndarray,
    rng: np.random.Generator,
    level: float = 0.95,
    *,
    statistic: Callable[..., np.ndarray] = np.mean,
    resamples: int = 2000,
) -> tuple[float, float]:
    """Percentile bootstrap interval of the mean (or another statistic).

    Args:
        values: (N,), for a recall the 0/1 outcomes.
        rng: where the resampling draws from.
        level: coverage, between 0 and 1.
        statistic: maps (R, N) and ``axis=1`` to (R,), such as ``np.mean`` or ``np.median``.
        resamples: how many resamples are drawn.

    Returns:
        Low and high end of the interval.

    Raises:
        ValueError: if there are no values, one is NaN, or the level is not between 0 and 1.
    """
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 1 or values.size == 0:
        raise ValueError(f"values must be a non-empty list of numbers, got shape {values.shape}")
    if np.isnan(values).any():
        raise ValueError("values has NaN entries")
    if not 0 < level < 1:
        raise ValueError(f"level must be between 0 and 1, got {level}")
    # A chunk at a time keeps the memory small for long lists.
    chunk = max(1, 1_000_000 // values.size)
    estimates = [
        statistic(
            values[rng.integers(values.size, size=(min(chunk, resamples - start), values.size))],
            axis=1,
        )
        for start in range(0, resamples, chunk)
    ]
    low, high = np.quantile(np.concatenate(estimates), [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


@lru_cache(maxsize=128)
def _surface_index(object_model: MeasuredObject) -> NearestPoints:
    return NearestPoints(object_model.points)


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=-1)


def _check_poses(T_est: np.ndarray, T_true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return check_rigid(T_est, "T_est"), check_rigid(T_true, "T_true")


def _check_points(points: np.ndarray) -> np.ndarray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise ValueError(f"points must be (P, 3) with P > 0, got shape {array.shape}")
    return array
