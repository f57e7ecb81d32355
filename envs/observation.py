"""The observation: computed from the estimate, the reference image and the camera poses only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from gymnasium import spaces

from ..core.geometry import crop_matrix, invert, rotation_to_6d
from ..pose_estimator.types import PoseEstimate

KEYPOINTS = 9
CROP_SCALE = 2.5
"""Side of the crop over that of the detection: it shows what may occlude the object elsewhere."""
UNCERTAINTY_UNIT = 0.01
"""Uncertainty is log10 of a keypoint's standard deviation in this unit, meters."""

# Out-of-range estimates are clipped to the space.
_TRANSLATION_LOW = np.array([-1.0, -1.0, 0.0], dtype=np.float32)
_TRANSLATION_HIGH = np.array([1.0, 1.0, 3.0], dtype=np.float32)
_CAMERA_LOW = np.array([0.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0], dtype=np.float32)
_CAMERA_HIGH = np.array([3.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0], dtype=np.float32)
_UNCERTAINTY_LIMIT = 2.0

Observation = dict[str, np.ndarray]


@dataclass(frozen=True)
class SpherePosition:
    """A camera pose in spherical coordinates about the center of a view sphere.

    Attributes:
        distance: from that center to the camera's center, meters.
        azimuth: about the world's z axis, radians, 0 along +x.
        elevation: above the horizontal plane through the center, radians.
        roll: of the image about the optical axis, radians; 0 if its rows are horizontal.
    """

    distance: float
    azimuth: float
    elevation: float
    roll: float

    @classmethod
    def of(cls, T_cam_world: np.ndarray, center: np.ndarray) -> SpherePosition:
        """Converts a camera pose (4, 4) relative to ``center`` (3,), world, meters."""
        T_world_cam = invert(T_cam_world)
        x, y, z = T_world_cam[:3, 3] - center
        right, down = T_world_cam[:3, 0], T_world_cam[:3, 1]
        return cls(
            distance=float(np.linalg.norm((x, y, z))),
            azimuth=float(np.arctan2(y, x)),
            elevation=float(np.arctan2(z, np.hypot(x, y))),
            roll=float(np.arctan2(-right[2], -down[2])),
        )


def observation_space(object_count: int, image_size: int) -> spaces.Dict:
    """The observation space; see ``TwoViewPoseEnv``."""

    def box(low: float | np.ndarray, high: float | np.ndarray, size: int) -> spaces.Box:
        return spaces.Box(low, high, (size,), np.float32)

    return spaces.Dict(
        {
            "rotation": box(-1.0, 1.0, 6),
            "translation": box(_TRANSLATION_LOW, _TRANSLATION_HIGH, 3),
            "uncertainty": box(-_UNCERTAINTY_LIMIT, _UNCERTAINTY_LIMIT, KEYPOINTS),
            "score": box(0.0, 1.0, 1),
            "object": box(0.0, 1.0, object_count),
            "camera": box(_CAMERA_LOW, _CAMERA_HIGH, 7),
            "image": spaces.Box(0, 255, (image_size, image_size, 3), np.uint8),
        }
    )


def make_observation(
    space: spaces.Dict,
    estimate: PoseEstimate | None,
    reference_image: np.ndarray,
    camera: SpherePosition,
    reference_azimuth: float,
    object_index: int,
) -> Observation:
    """Builds one observation of new arrays, clipped to ``space``.

    Args:
        space: from ``observation_space``.
        estimate: the latest estimate; None: its fields are zero, and the crop is the image's
            center.
        reference_image: RGB uint8, (H, W, 3).
        camera: the latest camera, relative to the estimated object.
        reference_azimuth: azimuth of the reference camera, radians.
        object_index: of the target.
    """
    boxes = cast(dict[str, spaces.Box], space.spaces)
    one_hot = np.zeros_like(boxes["object"].low)
    one_hot[object_index] = 1.0
    angles = (camera.elevation, camera.azimuth - reference_azimuth, camera.roll)
    values: dict[str, np.ndarray] = {
        "rotation": np.zeros(6),
        "translation": np.zeros(3),
        "uncertainty": np.zeros(KEYPOINTS),
        "score": np.zeros(1),
        "object": one_hot,
        "camera": np.array([camera.distance, *(f(a) for a in angles for f in (np.sin, np.cos))]),
    }
    if estimate is not None:
        values["rotation"] = rotation_to_6d(estimate.T_cam_obj[:3, :3])
        values["translation"] = estimate.T_cam_obj[:3, 3]
        values["uncertainty"] = _log_uncertainty(estimate.keypoint_covariance)
        values["score"] = np.nan_to_num([estimate.rois[0].score if estimate.rois else 0.0])
    observation = {
        key: np.clip(value, boxes[key].low, boxes[key].high).astype(np.float32)
        for key, value in values.items()
    }
    observation["image"] = _crop(reference_image, estimate, len(boxes["image"].low))
    return observation


def _log_uncertainty(covariance: np.ndarray) -> np.ndarray:
    """log10 of each keypoint's standard deviation over 1 cm, (9,); NaN counts as infinite."""
    variance = np.trace(np.asarray(covariance, dtype=np.float64), axis1=1, axis2=2)
    deviation = np.sqrt(np.clip(np.nan_to_num(variance, nan=np.inf), 1e-12, 1e12))
    return np.log10(deviation / UNCERTAINTY_UNIT)


def _crop(image: np.ndarray, estimate: PoseEstimate | None, size: int) -> np.ndarray:
    """Crops the image around the detection, (size, size, 3); gray outside the image."""
    height, width = image.shape[:2]
    center, side = np.array([(width - 1) / 2, (height - 1) / 2]), float(min(height, width))
    if estimate is not None and estimate.rois:
        roi = estimate.rois[0]
        if np.isfinite(roi.center).all() and np.isfinite(roi.side):
            center, side = roi.center, float(np.clip(CROP_SCALE * roi.side, 8.0, 2.0 * width))
    # warpAffine does not average when it shrinks: warp to a multiple of the size, then average.
    factor = max(1, int(np.ceil(side / size)))
    crop = cv2.warpAffine(
        image,
        crop_matrix(center, side, size * factor)[:2],
        (size * factor, size * factor),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(127, 127, 127),
    )
    return crop if factor == 1 else cv2.resize(crop, (size, size), interpolation=cv2.INTER_AREA)
