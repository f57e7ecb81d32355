"""Ground-truth (oracle) regions of interest, for analyses without the detector."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.geometry import View
from ..types import Roi, roi_of_pose

NOISE = {"truth": (0.0, 0.0), "noisy": (0.04, 0.012)}
"""Value of ``--roi`` -> standard deviations of the center in depth and sideways, meters."""


@dataclass(frozen=True)
class GroundTruthRois:
    """Makes regions of interest from true poses.

    Attributes:
        scale: side in diameters.
        depth_noise: standard deviation of the center's depth, meters.
        side_noise: that in x and in y, meters.
        seed: of the noise.
    """

    scale: float
    depth_noise: float = 0.0
    side_noise: float = 0.0
    seed: int = 0

    def make(
        self, T_cam_obj: Sequence[np.ndarray], views: Sequence[View], diameter: float, number: int
    ) -> list[Roi]:
        """Returns one region for each view.

        Args:
            T_cam_obj: the true pose in each view, (4, 4) each.
            views: images and cameras.
            diameter: of the object, meters.
            number: of the pair; determines the noise together with the seed.
        """
        rng = np.random.default_rng([self.seed, number])
        spread = (self.side_noise, self.side_noise, self.depth_noise)
        rois = []
        for T, view in zip(T_cam_obj, views, strict=True):
            moved = T.copy()
            moved[:3, 3] += spread * rng.standard_normal(3)
            rois.append(roi_of_pose(moved, view.K, diameter, self.scale))
        return rois
