"""What every estimator answers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..core.geometry import project

_MIN_AXIS_SINE = 0.3
"""Sine of the angle between an axis and the line of sight from which on its direction counts."""

_MIN_DEPTH = 0.1
"""Smallest depth in meters at which a region of interest is placed."""


@dataclass(frozen=True, eq=False)
class Roi:
    """A square region of one full frame in which the object was found.

    Attributes:
        center: pixels, (2,).
        side: pixels.
        score: how sure the detector was, 0 to 1.
    """

    center: np.ndarray
    side: float
    score: float


def roi_of_pose(
    T_cam_obj: np.ndarray, K: np.ndarray, diameter: float, scale: float, score: float = 1.0
) -> Roi:
    """The region of interest that an object in a known pose would have.

    Args:
        T_cam_obj: (4, 4), meters; one behind the camera is taken to be near it.
        K: camera matrix, (3, 3).
        diameter: of the object, meters.
        scale: side of the region in diameters.
        score: as the attribute of :class:`Roi`.
    """
    depth = max(float(T_cam_obj[2, 3]), _MIN_DEPTH)
    center = project(np.array([T_cam_obj[0, 3], T_cam_obj[1, 3], depth]), K)
    return Roi(center=center, side=scale * diameter * K[0, 0] / depth, score=score)


def upright_roll(T_cam_obj: np.ndarray, K: np.ndarray) -> float | None:
    """How far to turn a image so that an object's z axis, as it is seen, points up.

    Args:
        T_cam_obj: (4, 4), meters.
        K: camera matrix, (3, 3).

    Returns:
        Radians as :func:`rotation_matrix_2d` takes them, -pi to pi; None where the axis points so
        much towards the camera or away that it has no direction in the image.
    """
    center, axis = T_cam_obj[:3, 3], T_cam_obj[:3, 2]
    # The derivative of the projection at the center, along the axis.
    seen = K[:2, :2] @ (axis[:2] - axis[2] * center[:2] / max(center[2], _MIN_DEPTH))
    if np.hypot(*seen) < _MIN_AXIS_SINE * K[0, 0]:
        return None
    turn = -np.pi / 2 - np.arctan2(seen[1], seen[0])
    return float((turn + np.pi) % (2 * np.pi) - np.pi)


def depth_of_roi(roi: Roi, K: np.ndarray, diameter: float, scale: float) -> float:
    """The depth in meters at which an object fills its region; the inverse of `roi_of_pose`."""
    return scale * diameter * float(K[0, 0]) / max(roi.side, 1.0)


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """An object's pose, with how sure the estimator is of it.

    Attributes:
        T_cam_obj: the object in the reference camera, (4, 4) float64, meters.
        keypoints: the object's nine keypoints in the reference camera, (9, 3), meters.
        keypoint_covariance: their covariances, (9, 3, 3), square meters.
        rois: where the object was found, one region for each view, the reference first.
        solver_keypoints: what the solver was given, (9, 3), where the pose was refined after it and
            ``keypoints`` are those of the refined pose; else None.
    """

    T_cam_obj: np.ndarray
    keypoints: np.ndarray
    keypoint_covariance: np.ndarray
    rois: list[Roi] = field(default_factory=list)
    solver_keypoints: np.ndarray | None = None
