"""``single``: the pose from one image, by voted keypoints and uncertainty-driven PnP (PVNet)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import View, make_transform, transform
from ..networks.container import PoseNetworks
from ..networks.inference import Inference
from ..solvers.pnp import keypoints_covariance, uncertainty_pnp
from ..solvers.rigid import check_solver
from ..types import PoseEstimate, Roi, depth_of_roi
from .frontend import EncodedView, Frontend, Target

_MAX_DEPTH_RATIO = 2.0
"""Factor between the depths of a pose and of its region from which the pose is not believed; the
detector misjudges the size of a region by less than ten percent."""


Request = tuple[Sequence[View], str]
"""Views, the reference first, and the name of the object to look for."""


class SingleViewEstimator:
    """Pose from the reference view alone; further views are ignored.

    Args:
        networks: with their weights, on the device that is to be used; set to evaluation mode.
        solver: from 3D keypoints to the pose, one of ``solvers.SOLVERS``, for the estimators that
            have 3D keypoints; one view alone is solved by PnP.
        threads: of the processor; 0: as many as there are cores.

    Raises:
        InputError: if the solver is unknown.
    """

    thread_safe = True
    """Several threads may ask at the same time."""

    def __init__(self, networks: PoseNetworks, solver: str = "soft", threads: int = 0):
        self.networks = networks.eval()
        self.solver = check_solver(solver)
        self.inference = Inference(networks, threads)
        self.frontend = Frontend(networks, self.inference)

    @property
    def batch_size(self) -> int:
        """Requests at once from which on none gets quicker: they keep all cores, or a GPU, busy."""
        return 8 if self.inference.device.type == "cpu" else 64

    @property
    def object_names(self) -> tuple[str, ...]:
        """The objects that the weights know."""
        return tuple(self.networks.objects)

    def estimate(
        self, views: Sequence[View], object_name: str, rois: Sequence[Roi] | None = None
    ) -> PoseEstimate:
        """Estimates a pose: :meth:`estimate_batch` for one.

        Args:
            views: the reference view first.
            object_name: what to look for.
            rois: where to look, one region for each view, instead of where the detector would: for
                analyses that leave the detector out.

        Returns:
            The pose in the reference camera.

        Raises:
            InputError: if there is no view, the object is unknown, or there is not one region for
                each view.
        """
        return self.estimate_batch([(views, object_name)], None if rois is None else [rois])[0]

    def estimate_batch(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None = None
    ) -> list[PoseEstimate]:
        """Estimates several poses, with the networks' work done in batches.

        Args:
            requests: views and object name of each.
            rois: regions of each, see :meth:`estimate`.

        Returns:
            For each request what :meth:`estimate` answers: on a processor to the bit, on a GPU but
            for the rounding of another batch.

        Raises:
            InputError: see :meth:`estimate`.
        """
        targets = [target for target, *_ in self.targets(requests, rois)]
        encoded = self.frontend.encode(targets)
        return [self.from_one_view(e, name) for e, (_, name) in zip(encoded, requests, strict=True)]

    def targets(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None
    ) -> list[list[Target]]:
        """What is to be found in each view of each request, where it is told.

        Raises:
            InputError: see :meth:`estimate`.
        """
        targets = []
        for number, (views, name) in enumerate(requests):
            if len(views) == 0:
                raise InputError(
                    "estimate needs at least one view, the reference view first; got none"
                )
            regions = [None] * len(views) if rois is None else rois[number]
            if len(regions) != len(views):
                raise InputError(
                    f"rois must have one region for each of the {len(views)} views, "
                    f"got {len(regions)}"
                )
            index = self.index(name)
            targets.append(
                [Target(view, index, roi) for view, roi in zip(views, regions, strict=True)]
            )
        return targets

    def index(self, object_name: str) -> int:
        """Number of an object in the networks' order.

        Raises:
            InputError: if the weights do not know it.
        """
        try:
            return self.networks.index[object_name]
        except KeyError:
            raise InputError(
                f"these weights do not know the object {object_name!r}; they know "
                f"{', '.join(self.object_names)}. Train some that do: "
                f"python -m two_view_pose train-estimator --objects {object_name} --data DIR "
                "--init linemod --out DIR"
            ) from None

    def from_one_view(self, encoded: EncodedView, object_name: str) -> PoseEstimate:
        """Solves for the pose of an encoded view.

        Votes that fall into one point, as those of a hidden object may, fit a pose a hundred meters
        away as well. Where the pose is not at all at the depth that the region's size says, the
        object is placed there instead.
        """
        model = self.networks.objects[object_name]
        solution = uncertainty_pnp(
            model.keypoints, encoded.pixels, encoded.pixel_covariance, encoded.view.K
        )
        depth = depth_of_roi(
            encoded.roi, encoded.view.K, model.diameter, self.networks.features.config.roi_scale
        )
        if not depth / _MAX_DEPTH_RATIO < solution.T_cam_obj[2, 3] < depth * _MAX_DEPTH_RATIO:
            return _placed_by_region(encoded, solution.T_cam_obj[:3, :3], depth, model)
        return PoseEstimate(
            T_cam_obj=solution.T_cam_obj,
            keypoints=transform(solution.T_cam_obj, model.keypoints),
            keypoint_covariance=keypoints_covariance(
                solution.T_cam_obj, model.keypoints, solution.covariance
            ),
            rois=[encoded.roi],
        )


def _placed_by_region(
    encoded: EncodedView, rotation: np.ndarray, depth: float, model: ObjectModel
) -> PoseEstimate:
    """The pose of an object in the middle of its region, which is no better than a guess."""
    ray = np.linalg.inv(encoded.view.K) @ (*encoded.roi.center, 1.0)
    T = make_transform(rotation, depth * ray)
    spread = np.eye(3) * (0.5 * model.diameter) ** 2
    return PoseEstimate(
        T_cam_obj=T,
        keypoints=transform(T, model.keypoints),
        keypoint_covariance=np.tile(spread, (len(model.keypoints), 1, 1)),
        rois=[encoded.roi],
    )
