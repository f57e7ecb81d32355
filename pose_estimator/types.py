"""Regions of interest and pose estimates: what estimators take and return."""

from dataclasses import dataclass, field

import numpy as np

from ..core.geometry import project

_MIN_AXIS_SINE = 0.3
"""Smallest sine of the angle between an axis and the viewing ray for a usable direction."""

_MIN_DEPTH = 0.1
"""Meters: regions of interest of nearer objects are those at this depth."""


@dataclass(frozen=True, eq=False)
class Roi:
    """A square region of interest in a full frame.

    Attributes:
        center: pixels, (2,).
        side: pixels.
        score: detection confidence, 0 to 1.
    """

    center: np.ndarray
    side: float
    score: float


def roi_of_pose(
    T_cam_obj: np.ndarray, K: np.ndarray, diameter: float, scale: float, score: float = 1.0
) -> Roi:
    """Returns the region of interest of an object in a known pose.

    Args:
        T_cam_obj: (4, 4), meters; its depth is clipped to at least 0.1 m.
        K: camera matrix, (3, 3).
        diameter: of the object, meters.
        scale: side of the region in diameters.
        score: of the region.
    """
    depth = max(float(T_cam_obj[2, 3]), _MIN_DEPTH)
    center = project(np.array([T_cam_obj[0, 3], T_cam_obj[1, 3], depth]), K)
    return Roi(center=center, side=scale * diameter * K[0, 0] / depth, score=score)


def upright_roll(T_cam_obj: np.ndarray, K: np.ndarray) -> float | None:
    """Returns the image rotation after which the object's projected z axis points up.

    Args:
        T_cam_obj: (4, 4), meters.
        K: camera matrix, (3, 3).

    Returns:
        Radians for :func:`rotation_matrix_2d`, -pi to pi; None where the axis is nearly parallel to
        the viewing ray and has no direction in the image.
    """
    center, axis = T_cam_obj[:3, 3], T_cam_obj[:3, 2]
    # The derivative of the projection at the center, along the axis.
    direction = K[:2, :2] @ (axis[:2] - axis[2] * center[:2] / max(center[2], _MIN_DEPTH))
    if np.hypot(*direction) < _MIN_AXIS_SINE * K[0, 0]:
        return None
    roll = -np.pi / 2 - np.arctan2(direction[1], direction[0])
    return float((roll + np.pi) % (2 * np.pi) - np.pi)


def depth_of_roi(roi: Roi, K: np.ndarray, diameter: float, scale: float) -> float:
    """Returns the depth in meters from the region's size; the inverse of :func:`roi_of_pose`."""
    return scale * diameter * float(K[0, 0]) / max(roi.side, 1.0)


@dataclass(frozen=True)
class DepthUse:
    """What a depth map shows of an object.

    Attributes:
        points: number of known points on the object; with too few the pose is that of one view.
        share: of the object's pixels that have a known depth, 0 to 1.
        distance: median depth on the object, meters; None where none is known.
        expected: its depth by its size in the color image, meters.
    """

    points: int
    share: float
    distance: float | None
    expected: float


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """An object's pose with its uncertainty.

    Attributes:
        T_cam_obj: object to reference camera, (4, 4) float64, meters.
        keypoints: in the reference camera, (9, 3), meters.
        keypoint_covariance: (9, 3, 3), square meters.
        rois: the detected region of each view, the reference first.
        depth_use: what the depth map showed, of methods with depth.
    """

    T_cam_obj: np.ndarray
    keypoints: np.ndarray
    keypoint_covariance: np.ndarray
    rois: list[Roi] = field(default_factory=list)
    depth_use: DepthUse | None = None
