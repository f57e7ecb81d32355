"""Errors of estimated poses: ADD and ADD-S.

ADD is Hinterstoisser et al., ACCV 2012 (equation 4); ADD-S, for symmetric objects, is its nearest
point form (equation 5), with the argument order of the BOP toolkit. A pose counts as correct when
the error is below a tenth of the object's diameter.
"""

from functools import lru_cache

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import check_rigid, invert, transform
from ..bop.objects import EvaluationObject
from .nearest_points import NearestPoints

CORRECT = 0.1
"""ADD(-S) in diameters below which a pose counts as correct."""


MeasuredObject = ObjectModel | EvaluationObject
"""An object with surface points (P, 3) in its own frame and a diameter, in meters."""


def add(T_est: np.ndarray, T_true: np.ndarray, points: np.ndarray) -> float:
    """Mean distance between the points under the two poses (ADD).

    Args:
        T_est: estimated T_cam_obj, (4, 4).
        T_true: true T_cam_obj, (4, 4).
        points: model points in the object's frame, (P, 3), meters.

    Returns:
        Meters.

    Raises:
        InputError: if a pose is not rigid or the points are not (P, 3) with P > 0.
    """
    T_est, T_true = _check_poses(T_est, T_true)
    points = _check_points(points)
    moved = transform(T_est, points) - transform(T_true, points)
    return float(np.linalg.norm(moved, axis=-1).mean())


def add_s(
    T_est: np.ndarray, T_true: np.ndarray, points: np.ndarray, *, tree: NearestPoints | None = None
) -> float:
    """Mean distance from each point under the true pose to the nearest under the estimate (ADD-S).

    Arguments and errors are those of :func:`add`; ``tree`` is an index of ``points``, if there is
    one already.
    """
    T_est, T_true = _check_poses(T_est, T_true)
    points = _check_points(points)
    # The search runs in the object's frame (of the estimate), where one index serves every pose.
    motion = invert(T_est) @ T_true
    return (NearestPoints(points) if tree is None else tree).mean_distance(motion)


def add_or_add_s(T_est: np.ndarray, T_true: np.ndarray, object_model: MeasuredObject) -> float:
    """ADD(-S): ADD-S for a symmetric object and ADD for any other, in meters.

    Raises:
        InputError: if a pose is not rigid, or the object has no surface points.
    """
    if not len(object_model.points):
        raise InputError(
            f"ADD needs the surface of {object_model.name}, which is not stored with the weights: "
            f"give its mesh, --objects {object_model.name}=FILE, or a dataset that has models"
        )
    if object_model.symmetric:
        return add_s(T_est, T_true, object_model.points, tree=_surface_index(object_model))
    return add(T_est, T_true, object_model.points)


def nearest_symmetric_pose(T_est: np.ndarray, T_true: np.ndarray, model: ObjectModel) -> np.ndarray:
    """Returns the symmetry-equivalent of ``T_true`` with the nearest keypoints, (4, 4).

    Raises:
        InputError: if a pose is not rigid.
    """
    T_est, T_true = _check_poses(T_est, T_true)
    distances = _equivalent_distances(transform(T_est, model.keypoints), T_true, model)
    return (T_true @ model.symmetries)[int(np.argmin([d.mean() for d in distances]))]


def keypoint_distances(keypoints: np.ndarray, T_true: np.ndarray, model: ObjectModel) -> np.ndarray:
    """Returns the distances (9,) in meters of estimated 3D keypoints (9, 3) from the true ones.

    The symmetry-equivalent of ``T_true`` with the smallest mean distance counts.
    """
    return min(_equivalent_distances(keypoints, T_true, model), key=np.mean)


def _equivalent_distances(
    keypoints: np.ndarray, T_true: np.ndarray, model: ObjectModel
) -> list[np.ndarray]:
    truths = (transform(T_true @ S, model.keypoints) for S in model.symmetries)
    return [np.linalg.norm(keypoints - truth, axis=-1) for truth in truths]


@lru_cache(maxsize=128)
def _surface_index(object_model: MeasuredObject) -> NearestPoints:
    return NearestPoints(object_model.points)


def _check_poses(T_est: np.ndarray, T_true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return check_rigid(T_est, "T_est"), check_rigid(T_true, "T_true")


def _check_points(points: np.ndarray) -> np.ndarray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise InputError(f"points must be (P, 3) with P > 0, got shape {array.shape}")
    return array
