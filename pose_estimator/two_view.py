"""What all fusions of two (or more) views share: where to look, and to look twice.

The reference view is encoded first, and its pose says where to look in the further ones. The views
are fused; the fused pose crops every view anew; and the second votes are fused again. How the views
are fused is the method's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .estimate import PoseEstimate, Roi, roi_of_pose
from .frontend import EncodedView, merge_votes
from .geometry import View, invert, project, transform
from .single_view import SingleViewEstimator, check_rois, first_view
from .solvers import solve_pose
from .symmetry import keypoint_permutations

_LEAST_PRIOR = 25.0
_LARGEST_PRIOR = 150.0

_TURNS = (0.0, -0.2, 0.2)
"""Turns in radians of the crops of the second look, all within what the network was trained on."""


class TwoViewEstimator(SingleViewEstimator):
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
        raise NotImplementedError(f"{type(self).__name__} does not say how it fuses views")

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
        """Encodes all views, the further ones where the reference's pose says the object is.

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
        reference = first_view(views)
        given = [None] * len(views) if rois is None else check_rois(rois, views)
        encoded = [self.frontend.encode(reference, index, roi=given[0])]
        first = self.from_one_view(encoded[0], object_name)
        for view, roi in zip(views[1:], given[1:], strict=True):
            prior = expected_pixel(first, reference, view)
            encoded.append(self.frontend.encode(view, index, prior, roi))
        return encoded, first

    def look_again(
        self, encoded: Sequence[EncodedView], object_name: str, fused: PoseEstimate
    ) -> list[EncodedView]:
        """Crops every view where a first fusion says the object is, and votes once more.

        The detector misjudges the size of a region by some ten percent; a fused pose does not. And
        a network's errors differ a little from crop to crop: the votes of several are averaged.
        """
        model, index = self.networks.objects[object_name], self.index(object_name)
        permutations = keypoint_permutations(model.keypoints, model.symmetries)
        T_ref_world = encoded[0].view.T_cam_world
        scale = self.networks.features.config.roi_scale
        views = []
        for first in encoded:
            T = first.view.T_cam_world @ invert(T_ref_world) @ fused.T_cam_obj
            roi = roi_of_pose(T, first.view.K, model.diameter, scale, first.roi.score)
            upright, *turned = self.frontend.encode_turned(first.view, index, roi, _TURNS)
            views.append(merge_votes(upright, [*turned, first], permutations))
        return views


def expected_pixel(first: PoseEstimate, reference: View, view: View) -> tuple[np.ndarray, float]:
    """Where another view should see the object's centre: pixel (2,) and standard deviation."""
    T_view_ref = view.T_cam_world @ invert(reference.T_cam_world)
    centre = transform(T_view_ref, first.keypoints[-1])
    depth = max(float(centre[2]), 0.1)
    pixel = project(np.array([centre[0], centre[1], depth]), view.K)
    spread = float(np.sqrt(np.linalg.eigvalsh(first.keypoint_covariance[-1])[-1]))
    sigma = float(np.clip(view.K[0, 0] * spread / depth, _LEAST_PRIOR, _LARGEST_PRIOR))
    return pixel, sigma
