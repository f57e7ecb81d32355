"""Base class of the fusions of two (or more) views.

The object is detected in all views jointly and the views are fused. The fused pose gives new crops,
and a second pass fuses their votes. A method only adds how views are fused.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.geometry import invert
from ..solvers.rigid import solve_pose
from ..symmetry import keypoint_permutations
from ..types import PoseEstimate, Roi, roi_of_pose, upright_roll
from .frontend import EncodedView, Target, merge_votes
from .single import Request, SingleViewEstimator

_ROLLS = (0.0, -0.2, 0.2)
"""Rotations in radians of the second pass's crops, relative to the upright one."""

_MAX_ROLL = 1.5
"""Largest rotation in radians of the second pass's upright crop."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """The encoded views of one request, before their fusion.

    Attributes:
        encoded: its views, the reference first.
        object_name: the target.
        first: the best pose so far, from the reference alone or from an earlier fusion.
    """

    encoded: Sequence[EncodedView]
    object_name: str
    first: PoseEstimate


class TwoViewEstimator(SingleViewEstimator, ABC):
    """A fusion of views; a method adds :meth:`fuse`. With one view it is ``single``."""

    def estimate_batch(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None = None
    ) -> list[PoseEstimate]:
        sightings = self.encode_views(requests, rois)
        answers = [sighting.first for sighting in sightings]
        several = [n for n, sighting in enumerate(sightings) if len(sighting.encoded) > 1]
        fused = self.fuse([sightings[n] for n in several])
        found = zip(several, fused, strict=True)
        again = self.refine([replace(sightings[n], first=pose) for n, pose in found])
        for n, sighting, pose in zip(several, again, self.fuse(again), strict=True):
            answers[n] = replace(pose, rois=sighting.first.rois)
        return answers

    @abstractmethod
    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        """Fuses the views of each sighting into a pose in the reference camera."""

    def answer(
        self, sighting: Sighting, keypoints: np.ndarray, covariance: np.ndarray, *, weigh: bool
    ) -> PoseEstimate:
        """Solves for the pose of fused keypoints.

        Args:
            sighting: their views.
            keypoints: (9, 3) in the reference camera, m.
            covariance: (9, 3, 3).
            weigh: whether the solver weights keypoints by their covariances.
        """
        model = self.networks.objects[sighting.object_name]
        weights = covariance if weigh else None
        return PoseEstimate(
            T_cam_obj=solve_pose(model.keypoints, keypoints, model.diameter, self.solver, weights),
            keypoints=keypoints,
            keypoint_covariance=covariance,
            rois=[e.roi for e in sighting.encoded],
        )

    def encode_views(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None = None
    ) -> list[Sighting]:
        """Encodes views at jointly detected regions, and solves the references alone."""
        targets = self.targets(requests, rois)
        together = [n for n, own in enumerate(targets) if rois is None and len(own) > 1]
        found: list[list[Roi | None]] = []
        if together:
            found = self.frontend.regions([(requests[n][0], targets[n][0].obj) for n in together])
        for n, regions in zip(together, found, strict=True):
            targets[n] = [t._replace(roi=roi) for t, roi in zip(targets[n], regions, strict=True)]
        encoded = iter(self.frontend.encode([target for own in targets for target in own]))
        sightings = []
        for (_, name), own in zip(requests, targets, strict=True):
            views = [next(encoded) for _ in own]
            sightings.append(Sighting(views, name, self.from_one_view(views[0], name)))
        return sightings

    def refine(self, sightings: Sequence[Sighting]) -> list[Sighting]:
        """Crops every view at the fused pose, and votes again.

        The region's size is about ten percent off in the detector, not in a fused pose. The network
        was trained mostly on upright objects and underestimates tilt, so crops are rotated until
        the object is upright. Errors differ between crops, so the votes of several are averaged.
        """
        targets, rolls = [], []
        for sighting in sightings:
            model = self.networks.objects[sighting.object_name]
            T_ref_world = sighting.encoded[0].view.T_cam_world
            for seen in sighting.encoded:
                T = seen.view.T_cam_world @ invert(T_ref_world) @ sighting.first.T_cam_obj
                scale = self.networks.features.config.roi_scale
                roi = roi_of_pose(T, seen.view.K, model.diameter, scale, seen.roi.score)
                upright = upright_roll(T, seen.view.K)
                upright = seen.roll if upright is None else upright
                upright = float(np.clip(upright, -_MAX_ROLL, _MAX_ROLL))
                targets.append(Target(seen.view, self.index(sighting.object_name), roi))
                rolls.append([upright + roll for roll in _ROLLS])
        crops = iter(self.frontend.encode_rotated(targets, rolls))
        again = []
        for sighting in sightings:
            model = self.networks.objects[sighting.object_name]
            permutations = keypoint_permutations(model.keypoints, model.symmetries)
            views = []
            for seen in sighting.encoded:
                upright_crop, *rotated = next(crops)
                views.append(merge_votes(upright_crop, [*rotated, seen], permutations))
            again.append(replace(sighting, encoded=views))
        return again
