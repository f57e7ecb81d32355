"""``single``: the pose from one image, by voted keypoints and uncertainty-driven PnP (PVNet)."""

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
"""Between the depths of a pose and of its region; above, the pose is rejected. The detector's error
of a region's size is less than ten percent."""


Request = tuple[Sequence[View], str]
"""Views, the reference first, and the object's name."""


class SingleViewEstimator:
    """Estimates the pose from the reference view alone; further views are ignored.

    Args:
        networks: with their weights, on their device; set to evaluation mode.
        solver: of the subclasses, from 3D keypoints to the pose; a single view is solved by PnP.
        threads: CPU threads; 0: all cores.

    Raises:
        InputError: if the solver is unknown.
    """

    thread_safe = True
    """Several threads may call it at the same time."""

    def __init__(self, networks: PoseNetworks, solver: str = "soft", threads: int = 0):
        self.networks = networks.eval()
        self.solver = check_solver(solver)
        self.inference = Inference(networks, threads)
        self.frontend = Frontend(networks, self.inference)

    @property
    def batch_size(self) -> int:
        """Requests in a batch that keep all CPU cores, or a GPU, busy."""
        return 8 if self.inference.device.type == "cpu" else 64

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the objects that the weights know."""
        return tuple(self.networks.objects)

    def estimate(
        self, views: Sequence[View], object_name: str, rois: Sequence[Roi] | None = None
    ) -> PoseEstimate:
        """Estimates the pose of an object.

        Args:
            views: the reference view first.
            object_name: one of ``object_names``.
            rois: a region of interest for each view, instead of the detector's.

        Returns:
            The pose in the reference camera.

        Raises:
            InputError: if there is no view, the object is unknown, or the number of regions is not
                that of the views.
        """
        return self.estimate_batch([(views, object_name)], None if rois is None else [rois])[0]

    def estimate_batch(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None = None
    ) -> list[PoseEstimate]:
        """Estimates several poses with the networks in batches; arguments as for :meth:`estimate`.

        Results are those of :meth:`estimate`: bit-equal on a CPU, up to rounding on a GPU.
        """
        targets = [target for target, *_ in self.targets(requests, rois)]
        encoded = self.frontend.encode(targets)
        return [self.from_one_view(e, name) for e, (_, name) in zip(encoded, requests, strict=True)]

    def targets(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None
    ) -> list[list[Target]]:
        """Validates requests and returns the target in each view; see :meth:`estimate`."""
        targets = []
        for number, (views, name) in enumerate(requests):
            if len(views) == 0:
                raise InputError("estimate needs at least one view, the reference first; got none")
            regions = [None] * len(views) if rois is None else rois[number]
            if len(regions) != len(views):
                raise InputError(
                    f"rois must have one region for each of the {len(views)} views, "
                    f"got {len(regions)}"
                )
            index = self.index(name)
            pairs = zip(views, regions, strict=True)
            targets.append([Target(view, index, roi) for view, roi in pairs])
        return targets

    def index(self, object_name: str) -> int:
        """Returns the index of an object in the networks.

        Raises:
            InputError: if the weights do not know it.
        """
        if object_name not in self.networks.index:
            raise InputError(
                f"these weights do not know the object {object_name!r}; they know "
                f"{', '.join(self.object_names)}. Train some that do: "
                f"python -m two_view_pose train-estimator --objects {object_name} --data DIR "
                "--init linemod --out DIR"
            )
        return self.networks.index[object_name]

    def from_one_view(self, encoded: EncodedView, object_name: str) -> PoseEstimate:
        """Solves for the pose of an encoded view.

        Votes that collapse to a point, as for a hidden object, also fit a pose a hundred meters
        away. A pose whose depth contradicts the region's size is moved to the region's depth.
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
    """Returns the pose of an object at the center of its region, as a rough guess."""
    ray = np.linalg.inv(encoded.view.K) @ (*encoded.roi.center, 1.0)
    T = make_transform(rotation, depth * ray)
    spread = np.eye(3) * (0.5 * model.diameter) ** 2
    return PoseEstimate(
        T_cam_obj=T,
        keypoints=transform(T, model.keypoints),
        keypoint_covariance=np.tile(spread, (len(model.keypoints), 1, 1)),
        rois=[encoded.roi],
    )
