"""``late``: every view votes for its own 2D keypoints, and these are triangulated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .agreement import agree
from .estimate import PoseEstimate
from .frontend import EncodedView
from .linear_triangulation import triangulate_linearly
from .two_view import TwoViewEstimator


class LateFusionEstimator(TwoViewEstimator):
    """Late Fusion: the views meet only in the triangulation of their voted keypoints."""

    def fuse(
        self, encoded: Sequence[EncodedView], object_name: str, first: PoseEstimate
    ) -> PoseEstimate:
        model = self.networks.objects[object_name]
        agreed, _ = agree(encoded, model)
        keypoints, covariance = triangulate_linearly(
            np.stack([e.vote_mean for e in agreed]),
            np.stack([e.vote_covariance for e in agreed]),
            [e.K_grid for e in agreed],
            [e.view.T_cam_world for e in agreed],
        )
        return self.answer(encoded, object_name, keypoints, covariance, weigh=True)
