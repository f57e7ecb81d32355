"""``mid``: Mid-Fusion of two (or more) views in a feature volume.

``mid-pnp`` is the same, refined by the votes: 16 voxels a side are coarser than the 2D votes.
"""

from collections.abc import Sequence

import numpy as np
import torch

from ...core.geometry import invert
from ..networks.volume import ViewMaps
from ..types import PoseEstimate
from .estimator import KeypointEstimator, Sighting
from .frontend import EncodedView


class MidFusionEstimator(KeypointEstimator):
    """Mid-Fusion: lifts every view's features into one volume around the object."""

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        volumes = [
            (self._maps(s.consistent[0]), s.joint.keypoints[-1], s.model.diameter)
            for s in sightings
        ]
        found = self.inference.fuse(volumes)
        return [
            self.answer(sighting, *keypoints)
            for sighting, keypoints in zip(sightings, found, strict=True)
        ]

    def _maps(self, views: Sequence[EncodedView]) -> ViewMaps:
        """Returns the volume's input, a batch of one."""
        tensor = self.inference.tensor
        T_ref_world = invert(views[0].view.T_cam_world)
        projections = [e.K_grid @ (e.view.T_cam_world @ T_ref_world)[:3] for e in views]
        return ViewMaps(
            features=torch.stack([e.volume for e in views])[None],
            projection=tensor(np.stack(projections)[None]),
            vote_mean=tensor(np.stack([e.vote_mean for e in views])[None]),
            vote_covariance=tensor(np.stack([e.vote_covariance for e in views])[None]),
        )
