"""``late``: each view votes for 2D keypoints, which are triangulated."""

from collections.abc import Sequence

import numpy as np

from ..solvers.linear_triangulation import triangulate_linearly
from ..types import PoseEstimate
from .estimator import KeypointEstimator, Sighting


class LateFusionEstimator(KeypointEstimator):
    """Late Fusion: triangulates the voted keypoints of the views."""

    keypoints_from_votes = True

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        answers = []
        for sighting in sightings:
            views, _ = sighting.consistent
            keypoints, covariance = triangulate_linearly(
                np.stack([e.vote_mean for e in views]),
                np.stack([e.vote_covariance for e in views]),
                [e.K_grid for e in views],
                [e.view.T_cam_world for e in views],
            )
            answers.append(self.answer(sighting, keypoints, covariance))
        return answers
