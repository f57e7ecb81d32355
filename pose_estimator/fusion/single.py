"""``single``: the pose from the reference view alone, as PVNet's."""

from collections.abc import Sequence

from ..types import PoseEstimate
from .estimator import KeypointEstimator, Sighting
from .one_view import solve_one_view


class SingleViewEstimator(KeypointEstimator):
    """PnP on the votes of the reference view."""

    reference_only = keypoints_from_votes = True

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        return [solve_one_view(s.encoded[0], s.model, self.roi_scale) for s in sightings]
