"""``mid``: Mid-Fusion of two (or more) views in a feature volume.

The solver gets the volume's keypoints. Since 16 voxels a side are coarser than the 2D votes, the
pose is then refined with both.
"""

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
"""Added to the standard deviation of the volume's keypoints, in diameters."""


class MidFusionEstimator(TwoViewEstimator):
    """Mid-Fusion: lifts every view's features into one volume around the object."""

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
        """Returns the volume's input, a batch of one."""
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
        """Fits the pose to the volume's keypoints (9, 3) and the votes.

        ``joint`` is the pose from the votes alone, the answer if the depth is not consistent.
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
