"""The pose from the votes in one view, by uncertainty-driven PnP (PVNet)."""

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.geometry import make_transform, transform
from ..solvers.pnp import keypoints_covariance, uncertainty_pnp
from ..types import PoseEstimate, depth_of_roi
from .frontend import EncodedView

_MAX_DEPTH_RATIO = 2.0
"""Between the depths of a pose and of its region; above, the pose is rejected. The detector's error
of a region's size is less than ten percent."""


def solve_one_view(encoded: EncodedView, model: ObjectModel, roi_scale: float) -> PoseEstimate:
    """Solves for the pose of an encoded view.

    Votes that collapse to a point, as for a hidden object, also fit a pose a hundred meters away. A
    pose whose depth contradicts the region's size is moved to the region's depth.

    Args:
        encoded: the view.
        model: the object.
        roi_scale: side of the region in diameters.
    """
    solution = uncertainty_pnp(
        model.keypoints, encoded.pixels, encoded.pixel_covariance, encoded.view.K
    )
    T = solution.T_cam_obj
    depth = depth_of_roi(encoded.roi, encoded.view.K, model.diameter, roi_scale)
    if depth / _MAX_DEPTH_RATIO < T[2, 3] < depth * _MAX_DEPTH_RATIO:
        covariance = keypoints_covariance(T, model.keypoints, solution.covariance)
    else:  # a rough guess at the center of the region
        ray = np.linalg.inv(encoded.view.K) @ (*encoded.roi.center, 1.0)
        T = make_transform(T[:3, :3], depth * ray)
        spread = np.eye(3) * (0.5 * model.diameter) ** 2
        covariance = np.tile(spread, (len(model.keypoints), 1, 1))
    return PoseEstimate(
        T_cam_obj=T,
        keypoints=transform(T, model.keypoints),
        keypoint_covariance=covariance,
        rois=[encoded.roi],
    )
