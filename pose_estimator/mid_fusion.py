"""``mid``: the pose from two (or more) views, fused in a volume of features."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from .agreement import agree, joint_pose
from .estimate import PoseEstimate
from .frontend import EncodedView
from .geometry import invert
from .lifting import KeypointPrior, ViewMaps
from .two_view import TwoViewEstimator


class MidFusionEstimator(TwoViewEstimator):
    """Mid-Fusion: every view's features, lifted into one volume around the object."""

    def fuse(
        self, encoded: Sequence[EncodedView], object_name: str, first: PoseEstimate
    ) -> PoseEstimate:
        model = self.networks.objects[object_name]
        agreed, points = agree(encoded, model)
        joint = joint_pose(agreed, points, model, first)
        prior = KeypointPrior.from_poses([joint], [model.keypoints])
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
        with (
            torch.inference_mode(),
            torch.autocast("cpu", torch.bfloat16, enabled=self.frontend._bfloat16),
        ):
            diameter = torch.tensor([model.diameter], dtype=torch.float32)
            fine = self.networks.volume(maps, prior, diameter)[-1]
        keypoints = fine.keypoints[0].double().numpy()
        covariance = fine.covariance[0].double().numpy()
        return self.answer(encoded, object_name, keypoints, covariance, weigh=False)
