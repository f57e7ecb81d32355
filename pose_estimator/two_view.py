"""What all fusions of two (or more) views share: where to look, and to look twice.

The object is found in all views together. The views are fused; the fused pose crops every view
anew; and the second votes are fused again. How the views are fused is the method's own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .estimate import PoseEstimate, Roi, roi_of_pose, upright_turn
from .frontend import EncodedView, merge_votes
from .geometry import View, invert
from .single_view import SingleViewEstimator, check_rois, first_view
from .solvers import solve_pose
from .symmetry import keypoint_permutations

_TURNS = (0.0, -0.2, 0.2)
"""Turns in radians of the crops of the second look, from the one that shows the object upright."""

_LARGEST_TURN = 1.5
"""Largest turn in radians of a crop of the second look."""


class TwoViewEstimator(SingleViewEstimator, ABC):
    """A fusion of views; a method adds :meth:`fuse`.

    With one view it answers as ``single`` does: that is the first pose of the environment.
    """

    def estimate(
        self, views: Sequence[View], object_name: str, rois: Sequence[Roi] | None = None
    ) -> PoseEstimate:
        encoded, first = self.encode_views(views, object_name, rois)
        if len(views) == 1:
            return first
        fused = self.fuse(encoded, object_name, first)
        again = self.look_again(encoded, object_name, fused)
        return replace(self.fuse(again, object_name, fused), rois=fused.rois)

    @abstractmethod
    def fuse(
        self, encoded: Sequence[EncodedView], object_name: str, first: PoseEstimate
    ) -> PoseEstimate:
        """Fuses views into one pose.

        Args:
            encoded: two views or more, the reference first.
            object_name: what they show.
            first: the best pose so far: from the reference alone, or from an earlier fusion.

        Returns:
            The pose in the reference camera; ``keypoints`` are those that the solver was given, or
            those of a pose that was refined after it.
        """

    def answer(
        self,
        encoded: Sequence[EncodedView],
        object_name: str,
        keypoints: np.ndarray,
        covariance: np.ndarray,
        *,
        weigh: bool,
    ) -> PoseEstimate:
        """The pose of fused keypoints.

        Args:
            encoded: the views that they come from.
            object_name: whose keypoints they are.
            keypoints: (9, 3) in the reference camera, m.
            covariance: theirs, (9, 3, 3).
            weigh: let the solver trust each as far as its covariance says, instead of all alike.
        """
        model = self.networks.objects[object_name]
        trust = covariance if weigh else None
        return PoseEstimate(
            T_cam_obj=solve_pose(model.keypoints, keypoints, model.diameter, self.solver, trust),
            keypoints=keypoints,
            keypoint_covariance=covariance,
            rois=[e.roi for e in encoded],
        )

    def encode_views(
        self, views: Sequence[View], object_name: str, rois: Sequence[Roi] | None = None
    ) -> tuple[list[EncodedView], PoseEstimate]:
        """Encodes all views, each where the object was found in all of them together.

        Args:
            views: the reference view first.
            object_name: what to look for.
            rois: see :meth:`estimate`.

        Returns:
            The encoded views, and the pose from the reference alone.

        Raises:
            ValueError: see :meth:`estimate`.
        """
        index = self.index(object_name)
        first_view(views)
        given: Sequence[Roi | None] = [None]
        if rois is not None:
            given = check_rois(rois, views)
        elif len(views) > 1:
            given = self.frontend.regions(views, index)
        encoded = [
            self.frontend.encode(view, index, roi=roi)
            for view, roi in zip(views, given, strict=True)
        ]
        return encoded, self.from_one_view(encoded[0], object_name)

    def look_again(
        self, encoded: Sequence[EncodedView], object_name: str, fused: PoseEstimate
    ) -> list[EncodedView]:
        """Crops every view where a first fusion says the object is, and votes once more.

        The detector misjudges the size of a region by some ten percent; a fused pose does not. A
        network has seen most objects upright and believes a leaning one less leaning than it is: in
        the new crops it stands upright. And a network's errors differ a little from crop to crop:
        the votes of several are averaged.
        """
        model, index = self.networks.objects[object_name], self.index(object_name)
        permutations = keypoint_permutations(model.keypoints, model.symmetries)
        T_ref_world = encoded[0].view.T_cam_world
        scale = self.networks.features.config.roi_scale
        views = []
        for first in encoded:
            T = first.view.T_cam_world @ invert(T_ref_world) @ fused.T_cam_obj
            roi = roi_of_pose(T, first.view.K, model.diameter, scale, first.roi.score)
            upright = upright_turn(T, first.view.K)
            upright = first.turn if upright is None else upright
            upright = float(np.clip(upright, -_LARGEST_TURN, _LARGEST_TURN))
            turns = [upright + turn for turn in _TURNS]
            again, *turned = self.frontend.encode_turned(first.view, index, roi, turns)
            views.append(merge_votes(again, [*turned, first], permutations))
        return views
