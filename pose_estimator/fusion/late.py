"""``late``: each view votes for 2D keypoints, which are triangulated."""

from collections.abc import Sequence

import numpy as np

from ..solvers.linear_triangulation import triangulate_linearly
from ..types import PoseEstimate
from .symmetry_agreement import resolve_symmetry_ambiguity
from .two_view import Sighting, TwoViewEstimator


class LateFusionEstimator(TwoViewEstimator):
    """Late Fusion: triangulates the voted keypoints of the views."""

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        return [self._triangulated(sighting) for sighting in sightings]

    def _triangulated(self, sighting: Sighting) -> PoseEstimate:
        agreed, _ = resolve_symmetry_ambiguity(
            sighting.encoded, self.networks.objects[sighting.object_name]
        )
        keypoints, covariance = triangulate_linearly(
            np.stack([e.vote_mean for e in agreed]),
            np.stack([e.vote_covariance for e in agreed]),
            [e.K_grid for e in agreed],
            [e.view.T_cam_world for e in agreed],
        )
        return self.answer(sighting, keypoints, covariance, weigh=True)
