"""Stand-in estimators for the environment's tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import View, invert, make_transform
from two_view_pose.pose_estimator.types import PoseEstimate, Roi


def pose(rotation_vector: Sequence[float], translation: Sequence[float]) -> np.ndarray:
    """T from a rotation vector in radians and a translation in meters."""
    return make_transform(Rotation.from_rotvec(rotation_vector).as_matrix(), np.array(translation))


class ConstantEstimator:
    """Returns the same pose always, and records its inputs."""

    def __init__(
        self, T_cam_obj: np.ndarray | None = None, sigma: float = 0.02, score: float = 0.75
    ) -> None:
        default = pose((2.0, 0.3, -0.2), (0.05, 0.02, 0.9))
        self.T_cam_obj = default if T_cam_obj is None else T_cam_obj
        self.covariance = np.tile(sigma**2 / 3 * np.eye(3), (9, 1, 1))
        self.roi = Roi(np.array([80.0, 60.0]), 60.0, score)
        self.calls: list[tuple[tuple[View, ...], str]] = []

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate:
        self.calls.append((tuple(views), object_name))
        return PoseEstimate(
            self.T_cam_obj.copy(), np.zeros((9, 3)), self.covariance, [self.roi] * len(views)
        )


class TableEstimator(ConstantEstimator):
    """Returns the pose of an object upright at the center of the table."""

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate:
        self.T_cam_obj = views[0].T_cam_world @ pose((0.0, 0.0, 0.4), (0.0, 0.0, 0.03))
        return super().estimate(views, object_name)


class BatchedEstimator(TableEstimator):
    """Estimates batches, and records how many views each request had."""

    thread_safe = True

    def __init__(self) -> None:
        super().__init__()
        self.batches: list[tuple[int, ...]] = []

    def estimate_batch(self, requests: Sequence[tuple[Sequence[View], str]]) -> list[PoseEstimate]:
        self.batches.append(tuple(len(views) for views, _ in requests))
        return [TableEstimator().estimate(views, name) for views, name in requests]


class PickyEstimator(ConstantEstimator):
    """Knows two objects only."""

    object_names = ("brick", "post")


def relative(views: Sequence[View]) -> np.ndarray:
    """T_second_reference of the input of an estimator, (4, 4)."""
    return views[1].T_cam_world @ invert(views[0].T_cam_world)
