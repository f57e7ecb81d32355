"""Cases of the study's tests: a method that knows the truth, and outcomes made by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.pose_estimator.bop import BopDataset, read_rgb
from two_view_pose.pose_estimator.estimate import PoseEstimate
from two_view_pose.pose_estimator.geometry import View, transform
from two_view_pose.pose_estimator.study_log import PairOutcome


class Oracle:
    """Knows the truth by the look of the picture, and errs by a fixed motion.

    Attributes:
        asked: how many views and which object, each time.
        depth: which of the views had depth.
        told: T_second_ref, where there were two views.
    """

    def __init__(
        self,
        dataset: BopDataset,
        objects: Mapping[str, ObjectModel],
        T_error: np.ndarray | None = None,
        strict: bool = True,
    ):
        self.objects = objects
        self.strict = strict
        self.T_error = np.eye(4) if T_error is None else T_error
        self.asked: list[tuple[int, str]] = []
        self.depth: list[list[bool]] = []
        self.told: list[np.ndarray] = []
        self.truths = {
            (read_rgb(image).tobytes(), annotation.obj_id): annotation.T_cam_obj
            for image in dataset
            for annotation in image.annotations
        }

    @property
    def object_names(self) -> tuple[str, ...]:
        return tuple(self.objects)

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate:
        self.asked.append((len(views), object_name))
        self.depth.append([view.depth is not None for view in views])
        model = self.objects[object_name]
        truth = self.truths[views[0].image.tobytes(), model.obj_id]
        if len(views) == 2:
            self.told.append(views[1].T_cam_world @ np.linalg.inv(views[0].T_cam_world))
            other = self.truths[views[1].image.tobytes(), model.obj_id]
            assert not self.strict or np.allclose(self.told[-1] @ truth, other, atol=1e-5)
        T = truth @ self.T_error
        return PoseEstimate(T, transform(T, model.keypoints), 1e-6 * np.tile(np.eye(3), (9, 1, 1)))


def outcome(
    scene: int = 0,
    name: str = "cat",
    gap: int = 10,
    error: float = 0.05,
    distance: float = 0.004,
    *,
    reference: int = 0,
    camera: float = 0.85,
    solvers: Mapping[str, float] | None = None,
) -> PairOutcome:
    """An outcome whose nine keypoints are all equally far from the truth."""
    return PairOutcome(
        scene_id=scene,
        ref_image_id=reference,
        second_image_id=reference + gap,
        object_name=name,
        gap=gap,
        error=error,
        distances=(distance,) * 9,
        camera_distance=camera,
        visibility=1.0,
        baseline=2.0 * gap,
        seconds=0.1,
        solver_errors=solvers or {},
    )
