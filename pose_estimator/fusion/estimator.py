"""Base class of the estimators: from views to a pose.

The object is detected in every view, jointly if there are several, and a first pose is fitted to
the votes of all. It gives new crops, in which the networks vote again. All methods share these
votes; a method adds how its pose is found.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import View, invert
from ..methods import check_refinement
from ..networks.container import PoseNetworks
from ..networks.inference import Inference
from ..solvers.rigid import check_solver, solve_pose
from ..symmetry import keypoint_permutations
from ..types import PoseEstimate, Roi, roi_of_pose, upright_roll
from .frontend import EncodedView, Frontend, Target, merge_votes
from .joint_pnp import consistent_views, fit_joint_pose, refined_by_votes
from .lru_cache import LruCache
from .one_view import solve_one_view

_ROLLS = (0.0, -0.2, 0.2)
"""Rotations in radians of the second pass's crops, relative to the upright one."""

_MAX_ROLL = 1.5
"""Largest rotation in radians of the second pass's upright crop."""

Request = tuple[Sequence[View], str]
"""Views, the reference first, and the object's name."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """The encoded views of one request.

    Attributes:
        encoded: its views, the reference first.
        index: of the target in the networks.
        model: the target.
        first: the best pose so far.
    """

    encoded: Sequence[EncodedView]
    index: int
    model: ObjectModel
    first: PoseEstimate

    @cached_property
    def consistent(self) -> tuple[Sequence[EncodedView], np.ndarray]:
        """See :func:`consistent_views`."""
        return consistent_views(self.encoded, self.model)

    @cached_property
    def joint(self) -> PoseEstimate:
        """The pose from the votes of all views, without a method's own keypoints."""
        return fit_joint_pose(*self.consistent, self.model, self.first)


class KeypointEstimator(ABC):
    """Estimates poses from keypoints; a method adds :meth:`fuse`. With one view all are ``single``.

    Args:
        networks: with their weights, on their device; set to evaluation mode.
        solver: from 3D keypoints to the pose.
        threads: CPU threads; 0: all cores.
        refine: ``votes`` to fit the pose to the votes of all views and the method's keypoints
            together, or ``none``.

    Attributes:
        encodings: both passes of the last requests, where several methods with the same networks
            get the same views one after the other; None: every request is encoded.

    Raises:
        InputError: if solver or refinement is unknown.
    """

    thread_safe = True
    """Several threads may call it at the same time."""

    reference_only = False
    """Whether further views are ignored."""

    keypoints_from_votes = False
    """Whether a method's keypoints follow from the votes alone, so that they add no information."""

    def __init__(
        self, networks: PoseNetworks, solver: str = "soft", threads: int = 0, refine: str = "none"
    ):
        self.networks = networks.eval()
        self.solver = check_solver(solver)
        self.refinement = check_refinement(refine)
        self.inference = Inference(networks, threads)
        self.frontend = Frontend(networks, self.inference)
        self.encodings: LruCache[tuple[Sighting, Sighting]] | None = None

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
        encoded = self.encode(requests, rois)
        seen, again = [first for first, _ in encoded], [second for _, second in encoded]
        answers = [solve_one_view(s.encoded[0], s.model, self.roi_scale) for s in again]
        usable = [n for n, s in enumerate(again) if self.reference_only or len(s.encoded) > 1]
        fused = self.fuse([again[n] for n in usable])
        for n, pose in zip(usable, fused, strict=True):
            answers[n] = pose
            if self.refinement == "votes":
                sighting = again[n]
                answers[n] = refined_by_votes(
                    pose, sighting.consistent[0], sighting.model, sighting.joint,
                    sighting.first, with_keypoints=not self.keypoints_from_votes,
                )  # fmt: skip
        return [
            replace(pose, rois=[e.roi for e in sighting.encoded])
            for pose, sighting in zip(answers, seen, strict=True)
        ]

    @abstractmethod
    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        """Returns the method's pose of each sighting, in the reference camera."""

    def answer(
        self, sighting: Sighting, keypoints: np.ndarray, covariance: np.ndarray
    ) -> PoseEstimate:
        """Solves for the pose of keypoints (9, 3) in the reference camera, m.

        Their ``covariance`` (9, 3, 3) is reported; the solver takes all alike.
        """
        model = sighting.model
        return PoseEstimate(
            T_cam_obj=solve_pose(model.keypoints, keypoints, model.diameter, self.solver),
            keypoints=keypoints,
            keypoint_covariance=covariance,
        )

    def encode(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None
    ) -> list[tuple[Sighting, Sighting]]:
        """Returns both passes of each request; see :meth:`estimate`."""
        if self.encodings is None or rois is not None:
            return self._encode_twice(requests, rois)
        keys = [(name, self.reference_only, *map(id, views)) for views, name in requests]
        found = [
            self.encodings.get(views[0], key)
            for (views, _), key in zip(requests, keys, strict=True)
        ]
        missing = [number for number, known in enumerate(found) if known is None]
        new = self._encode_twice([requests[number] for number in missing], None)
        for number, encoded in zip(missing, new, strict=True):
            self.encodings.put(requests[number][0][0], keys[number], encoded)
            found[number] = encoded
        return [encoded for encoded in found if encoded is not None]

    def _encode_twice(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None
    ) -> list[tuple[Sighting, Sighting]]:
        targets = self.targets(requests, rois)
        if self.reference_only:
            targets = [own[:1] for own in targets]
        seen = self.encode_views(targets, [name for _, name in requests])
        return list(zip(seen, self.encode_again(seen), strict=True))

    @property
    def roi_scale(self) -> float:
        """Side of a region of interest in object diameters."""
        return self.networks.features.config.roi_scale

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

    def encode_views(
        self, targets: Sequence[Sequence[Target]], names: Sequence[str]
    ) -> list[Sighting]:
        """Encodes views at their regions, detected jointly if not given; poses are of one view."""
        targets = [list(own) for own in targets]
        together = [n for n, own in enumerate(targets) if len(own) > 1 and own[0].roi is None]
        found: list[list[Roi | None]] = []
        if together:
            asked = [([t.view for t in targets[n]], targets[n][0].obj) for n in together]
            found = self.frontend.regions(asked)
        for n, regions in zip(together, found, strict=True):
            targets[n] = [t._replace(roi=roi) for t, roi in zip(targets[n], regions, strict=True)]
        encoded = iter(self.frontend.encode([target for own in targets for target in own]))
        sightings = []
        for name, own in zip(names, targets, strict=True):
            views, model = [next(encoded) for _ in own], self.networks.objects[name]
            first = solve_one_view(views[0], model, self.roi_scale)
            sightings.append(Sighting(views, own[0].obj, model, first))
        return sightings

    def encode_again(self, sightings: Sequence[Sighting]) -> list[Sighting]:
        """Crops every view at the pose from all votes, and votes again.

        The region's size is about ten percent off in the detector, not in a fitted pose. The
        network was trained mostly on upright objects and underestimates tilt, so crops are rotated
        until the object is upright. Errors differ between crops, so the votes of several are
        averaged.
        """
        targets, rolls = [], []
        for sighting in sightings:
            model, T_ref_world = sighting.model, sighting.encoded[0].view.T_cam_world
            for seen in sighting.encoded:
                T = seen.view.T_cam_world @ invert(T_ref_world) @ sighting.joint.T_cam_obj
                roi = roi_of_pose(T, seen.view.K, model.diameter, self.roi_scale, seen.roi.score)
                upright = upright_roll(T, seen.view.K)
                upright = seen.roll if upright is None else upright
                upright = float(np.clip(upright, -_MAX_ROLL, _MAX_ROLL))
                targets.append(Target(seen.view, sighting.index, roi))
                rolls.append([upright + roll for roll in _ROLLS])
        crops = iter(self.frontend.encode_rotated(targets, rolls))
        again = []
        for sighting in sightings:
            model = sighting.model
            permutations = keypoint_permutations(model.keypoints, model.symmetries)
            views = []
            for seen in sighting.encoded:
                upright_crop, *rotated = next(crops)
                views.append(merge_votes(upright_crop, [*rotated, seen], permutations))
            again.append(Sighting(views, sighting.index, model, sighting.joint))
        return again
