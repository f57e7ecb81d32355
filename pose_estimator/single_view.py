"""``single``: the pose from one picture, by voted keypoints and uncertainty-driven PnP (PVNet)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .estimate import PoseEstimate
from .frontend import EncodedView, Frontend
from .geometry import View, transform
from .networks import PoseNetworks
from .pnp import PnpResult, keypoints_covariance, uncertainty_pnp


class SingleViewEstimator:
    """Pose from the reference view alone; further views are ignored.

    Args:
        networks: with their weights; set to evaluation mode.
    """

    def __init__(self, networks: PoseNetworks):
        self.networks = networks.eval()
        self.frontend = Frontend(networks)

    @property
    def object_names(self) -> tuple[str, ...]:
        """The objects that the weights know."""
        return tuple(self.networks.objects)

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate:
        """Estimates a pose.

        Args:
            views: the reference view first.
            object_name: what to look for.

        Returns:
            The pose in the reference camera.

        Raises:
            ValueError: if there is no view or the object is unknown.
        """
        encoded = self.frontend.encode(first_view(views), self.index(object_name))
        return self.from_one_view(encoded, object_name)

    def index(self, object_name: str) -> int:
        """Number of an object in the networks' order.

        Raises:
            ValueError: if the weights do not know it.
        """
        try:
            return self.networks.index[object_name]
        except KeyError:
            raise ValueError(
                f"these weights do not know the object {object_name!r}; they know "
                f"{', '.join(self.object_names)}. Train some that do: "
                f"python -m two_view_pose train-estimator --objects {object_name} --out DIR"
            ) from None

    def from_one_view(self, encoded: EncodedView, object_name: str) -> PoseEstimate:
        """Solves for the pose of an encoded view."""
        model = self.networks.objects[object_name]
        solution = solve_pnp(encoded, model.keypoints)
        return PoseEstimate(
            T_cam_obj=solution.T_cam_obj,
            keypoints=transform(solution.T_cam_obj, model.keypoints),
            keypoint_covariance=keypoints_covariance(
                solution.T_cam_obj, model.keypoints, solution.covariance
            ),
            rois=[encoded.roi],
        )


def solve_pnp(encoded: EncodedView, keypoints: np.ndarray) -> PnpResult:
    """The pose that explains a view's votes for keypoints (9, 3)."""
    return uncertainty_pnp(keypoints, encoded.pixels, encoded.pixel_covariance, encoded.view.K)


def first_view(views: Sequence[View]) -> View:
    """The reference view.

    Raises:
        ValueError: if there is none.
    """
    if len(views) == 0:
        raise ValueError("estimate needs at least one view, the reference view first; got none")
    return views[0]
