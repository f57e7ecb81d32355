"""What every estimator answers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class Roi:
    """A square region of one full frame in which the object was found.

    Attributes:
        centre: pixels, (2,).
        side: pixels.
        score: how sure the detector was, 0 to 1.
    """

    centre: np.ndarray
    side: float
    score: float


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """An object's pose, with how sure the estimator is of it.

    Attributes:
        T_cam_obj: the object in the reference camera, (4, 4) float64, metres.
        keypoints: the object's nine keypoints in the reference camera, (9, 3), metres.
        keypoint_covariance: their covariances, (9, 3, 3), square metres.
        rois: where the object was found, one region for each view, the reference first.
    """

    T_cam_obj: np.ndarray
    keypoints: np.ndarray
    keypoint_covariance: np.ndarray
    rois: list[Roi] = field(default_factory=list)
