"""``uncertainty``: next best view by Fisher information of the keypoints.

As for robots that measure points with a camera (Zhang and Scaramuzza, "Beyond point clouds: Fisher
information field for active visual localization", ICRA 2019; Kiciroglu et al., "ActiveMoCap", CVPR
2020, choose views by the projected covariance). Each keypoint has a covariance. A view measures its
two pixel coordinates, which adds the information J^T R^-1 J, where J is the projection's Jacobian.
The policy takes the view with the smallest sum of posterior variances. It ignores occlusion.
"""

from collections.abc import Mapping

import numpy as np

from ...core.errors import InputError
from ...core.geometry import invert, transform
from .baselines import ViewSpherePolicy
from .view_sphere import Action, camera_poses, candidate_actions

PIXEL_DEVIATION = 2.0
"""Standard deviation of a voted keypoint, pixels of the full image; that of the shipped networks is
1.5 to 3."""

_MIN_DEPTH = 0.05
_MIN_VARIANCE = 1e-10


class UncertaintyPolicy(ViewSpherePolicy):
    """Takes the view after which the keypoints' covariances have the smallest trace."""

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Returns the best view, of equal ones the first; raises InputError without estimator."""
        estimate = self._env.estimate
        if estimate is None:
            raise InputError("uncertainty needs an environment with an estimator")
        actions = candidate_actions(self._env)
        relative = camera_poses(self._env, actions) @ invert(self._env.T_cam_world)
        known = estimate.keypoints, estimate.keypoint_covariance
        variances = [predicted_variance(*known, T, self._env.intrinsics) for T in relative]
        return actions[int(np.argmin(variances))]


def predicted_variance(
    keypoints: np.ndarray,
    covariance: np.ndarray,
    T_second_ref: np.ndarray,
    K: np.ndarray,
    deviation: float = PIXEL_DEVIATION,
) -> float:
    """Sum of the keypoints' variances after a second view, square meters.

    Args:
        keypoints: (N, 3) in the reference camera, meters.
        covariance: of the keypoints, (N, 3, 3), square meters.
        T_second_ref: reference camera to second camera, (4, 4).
        K: camera matrix of both, (3, 3).
        deviation: of a measured keypoint, pixels.
    """
    points = transform(T_second_ref, keypoints)
    x, y, z = points[:, 0], points[:, 1], np.maximum(points[:, 2], _MIN_DEPTH)
    J = np.zeros((len(points), 2, 3))
    J[:, 0, 0], J[:, 0, 2] = K[0, 0] / z, -K[0, 0] * x / z**2
    J[:, 1, 1], J[:, 1, 2] = K[1, 1] / z, -K[1, 1] * y / z**2
    J = J @ T_second_ref[:3, :3]
    floor = _MIN_VARIANCE * np.eye(3)
    prior = np.linalg.inv(np.nan_to_num(covariance) + floor)
    posterior = np.linalg.inv(prior + J.transpose(0, 2, 1) @ J / deviation**2)
    return float(np.trace(posterior, axis1=1, axis2=2).sum())
