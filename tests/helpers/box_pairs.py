"""A stub of a training set: pairs of views of a box with depth."""

from types import SimpleNamespace

import numpy as np
from helpers.boxes import box_depth
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import LINEMOD_K, crop_matrix, invert, make_transform, project
from two_view_pose.pose_estimator.training_data.target_sample import TargetSample

SIDE = 128


class Pairs:
    """Stub of a TrainingSet: pairs of views of a box without background."""

    targets = (0,)
    pack = SimpleNamespace(depth=lambda target: True)

    def __init__(self, boxes):
        self.models = list(boxes.values())

    def view(self, index: int, T_cam_obj: np.ndarray, rng: np.random.Generator) -> TargetSample:
        model = self.models[index]
        side = 1.4 * model.diameter * LINEMOD_K[0, 0] / T_cam_obj[2, 3]
        center = project(T_cam_obj[:3, 3], LINEMOD_K) + rng.normal(0, 3, 2)
        K = crop_matrix(center, side, SIDE) @ LINEMOD_K
        depth = box_depth(model, T_cam_obj, K, (SIDE, SIDE))
        covered = (depth > 0).reshape(32, 4, 32, 4).mean((1, 3)).astype(np.float32)
        return TargetSample(
            crop=rng.integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8),
            mask=covered,
            directions=np.zeros((9, 2, 32, 32), np.float32),
            object_index=index,
            K=K,
            T_cam_obj=T_cam_obj,
            depth=depth,
        )

    def draw_pair(self, rng: np.random.Generator):
        index = int(rng.integers(len(self.models)))
        first, second = (
            make_transform(
                Rotation.from_euler("xyz", [2.2 + angle, angle, 0.3]).as_matrix(),
                np.array([0.02, -0.03, distance]),
            )
            for angle, distance in ((0.0, 0.8), (0.4, 0.9))
        )
        views = self.view(index, first, rng), self.view(index, second, rng)
        return *views, second @ invert(first)
