"""``pnp``: one pose for the votes of all views, without a fusion in 3D. Ours."""

from collections.abc import Sequence

from ..types import PoseEstimate
from .estimator import KeypointEstimator, Sighting


class JointPnpEstimator(KeypointEstimator):
    """PnP on the votes of all views together."""

    keypoints_from_votes = True

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        return [sighting.joint for sighting in sightings]
