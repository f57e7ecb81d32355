"""For tests of evaluations: a method that returns the ground truth, and made outcomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import View, transform
from two_view_pose.core.results import check_record
from two_view_pose.pose_estimator.bop.dataset import BopDataset, read_rgb
from two_view_pose.pose_estimator.study.log import PairOutcome
from two_view_pose.pose_estimator.types import PoseEstimate


class Oracle:
    """Looks the true pose up by the image, and adds a fixed error.

    Args:
        dataset: its images and true poses.
        objects: that it estimates.
        T_error: of every pose, (4, 4) in the object's frame.
        strict: whether the relative pose must lead from one true pose to the other.

    Attributes:
        requests: arguments of each call: views, object, and regions of interest if any.
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
        self.requests: list[tuple] = []
        self.truths = {
            (read_rgb(image).tobytes(), annotation.obj_id): annotation.T_cam_obj
            for image in dataset
            for annotation in image.annotations
        }

    @property
    def object_names(self) -> tuple[str, ...]:
        return tuple(self.objects)

    @property
    def asked(self) -> list[tuple[int, str]]:
        """Number of views and object of each call."""
        return [(len(views), name) for views, name, *_ in self.requests]

    @property
    def relative_poses(self) -> list[np.ndarray]:
        """T_second_ref (4, 4) of each call with two views."""
        pairs = (views for views, *_ in self.requests if len(views) == 2)
        return [b.T_cam_world @ np.linalg.inv(a.T_cam_world) for a, b in pairs]

    def estimate(self, views: Sequence[View], object_name: str, *rois: object) -> PoseEstimate:
        self.requests.append((views, object_name, *rois))
        model = self.objects[object_name]
        truth = self.truths[views[0].image.tobytes(), model.obj_id]
        if len(views) == 2 and self.strict:
            other = self.truths[views[1].image.tobytes(), model.obj_id]
            assert np.allclose(self.relative_poses[-1] @ truth, other, atol=1e-5)
        T = truth @ self.T_error
        return PoseEstimate(T, transform(T, model.keypoints), 1e-6 * np.tile(np.eye(3), (9, 1, 1)))


def only_record(records: Sequence[Mapping], metric: str, **tags: object) -> dict:
    """The only record with these tags."""
    (record,) = [
        r for r in records if r["metric"] == metric and all(r.get(k) == v for k, v in tags.items())
    ]
    return check_record(record)


def outcome(
    scene: int = 0,
    name: str = "cat",
    gap: int = 10,
    error: float = 0.05,
    distance: float = 0.004,
    *,
    reference: int = 0,
    camera: float = 0.085,
    visibility: float = 1.0,
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
        camera_baseline=camera,
        visibility=visibility,
        baseline=2.0 * gap,
        solver_errors=solvers or {},
    )
