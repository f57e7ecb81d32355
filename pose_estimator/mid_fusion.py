"""``mid``: the pose from two (or more) views, fused in a volume of features.

The keypoints of the volume are solved for the pose. A volume of 16 voxels a side cannot be as sharp
as the votes of pictures, so the pose is then refined to explain both: keypoints in space and votes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from .agreement import agree, believable, explain, joint_pose
from .estimate import PoseEstimate
from .frontend import EncodedView
from .geometry import invert, transform
from .inference import Fuse
from .multi_view_pnp import SpacePoints
from .two_view import TwoViewEstimator
from .volume import LevelOutput, ViewMaps

_LEAST_DEVIATION = 0.02
"""Standard deviation in diameters that the volume's keypoints are believed at best."""


class MidFusionEstimator(TwoViewEstimator):
    """Mid-Fusion: every view's features, lifted into one volume around the object."""

    def fuse(
        self, encoded: Sequence[EncodedView], object_name: str, first: PoseEstimate
    ) -> PoseEstimate:
        model = self.networks.objects[object_name]
        agreed, points = agree(encoded, model)
        joint = joint_pose(agreed, points, model, first)
        guess = transform(joint, model.keypoints[-1])
        T_ref_world = invert(encoded[0].view.T_cam_world)
        projections = [e.K_grid @ (e.view.T_cam_world @ T_ref_world)[:3] for e in agreed]
        maps = ViewMaps(
            features=torch.stack([e.volume for e in agreed])[None],
            projection=torch.from_numpy(np.stack(projections)).float()[None],
            vote_mean=torch.from_numpy(np.stack([e.vote_mean for e in agreed])).float()[None],
            vote_covariance=torch.from_numpy(np.stack([e.vote_covariance for e in agreed])).float()[
                None
            ],
        )
        fine: LevelOutput = self.ask(Fuse(maps, guess, model.diameter))
        keypoints = fine.keypoints[0].double().numpy()
        covariance = fine.covariance[0].double().numpy()
        solved = self.answer(encoded, object_name, keypoints, covariance, weigh=False)
        floor = (_LEAST_DEVIATION * model.diameter) ** 2 * np.eye(3)
        found = SpacePoints(keypoints, covariance + floor)
        T = explain(agreed, model, [solved.T_cam_obj, joint], found)
        if not believable(T, first, model):
            T = joint
        return replace(
            solved,
            T_cam_obj=T,
            keypoints=transform(T, model.keypoints),
            solver_keypoints=keypoints,
        )
