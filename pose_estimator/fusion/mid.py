"""``mid``: the pose from two (or more) views, fused in a volume of features.

The keypoints of the volume are solved for the pose. A volume of 16 voxels a side cannot be as sharp
as the votes of images, so the pose is then refined to explain both: keypoints in space and votes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ...core.geometry import invert, transform
from ..networks.volume import ViewMaps
from ..solvers.multi_view_pnp import SpacePoints
from ..types import PoseEstimate
from .frontend import EncodedView
from .symmetry_agreement import (
    depth_is_consistent,
    fit_multi_view_pose,
    joint_pose,
    resolve_symmetry_ambiguity,
)
from .two_view import Sighting, TwoViewEstimator

_MIN_STD = 0.02
"""Standard deviation in diameters that the volume's keypoints are believed at best."""


class MidFusionEstimator(TwoViewEstimator):
    """Mid-Fusion: every view's features, lifted into one volume around the object."""

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        volumes, before = [], []
        for sighting in sightings:
            model = self.networks.objects[sighting.object_name]
            agreed, points = resolve_symmetry_ambiguity(sighting.encoded, model)
            joint = joint_pose(agreed, points, model, sighting.first)
            before.append((agreed, joint))
            guess = transform(joint, model.keypoints[-1])
            volumes.append((self._maps(agreed), guess, model.diameter))
        found = self.inference.fuse(volumes)
        return [
            self._refined(sighting, *known, *keypoints)
            for sighting, known, keypoints in zip(sightings, before, found, strict=True)
        ]

    def _maps(self, agreed: Sequence[EncodedView]) -> ViewMaps:
        """What the views bring to the volume, a batch of one."""
        tensor = self.inference.tensor
        T_ref_world = invert(agreed[0].view.T_cam_world)
        projections = [e.K_grid @ (e.view.T_cam_world @ T_ref_world)[:3] for e in agreed]
        return ViewMaps(
            features=torch.stack([e.volume for e in agreed])[None],
            projection=tensor(np.stack(projections)[None]),
            vote_mean=tensor(np.stack([e.vote_mean for e in agreed])[None]),
            vote_covariance=tensor(np.stack([e.vote_covariance for e in agreed])[None]),
        )

    def _refined(
        self,
        sighting: Sighting,
        agreed: Sequence[EncodedView],
        joint: np.ndarray,
        keypoints: np.ndarray,
        covariance: np.ndarray,
    ) -> PoseEstimate:
        """The pose that explains the volume's keypoints and the votes.

        Args:
            sighting: the views as they voted.
            agreed: the views, consistently labeled (see :func:`resolve_symmetry_ambiguity`).
            joint: the pose (4, 4) from the votes alone.
            keypoints: the volume's, (9, 3) in the reference camera, m.
            covariance: theirs, (9, 3, 3).
        """
        model = self.networks.objects[sighting.object_name]
        solved = self.answer(sighting, keypoints, covariance, weigh=False)
        floor = (_MIN_STD * model.diameter) ** 2 * np.eye(3)
        found = SpacePoints(keypoints, covariance + floor)
        T = fit_multi_view_pose(agreed, model, [solved.T_cam_obj, joint], found)
        if not depth_is_consistent(T, sighting.first, model):
            T = joint
        return replace(
            solved,
            T_cam_obj=T,
            keypoints=transform(T, model.keypoints),
            solver_keypoints=keypoints,
        )
