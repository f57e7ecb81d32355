"""One pose for the votes of several views: makes them consistent, and fits it to all.

Each view may vote for another of the equivalent poses. A symmetry permutes the keypoints, so the
permutation that triangulates best is taken.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.geometry import invert, project, transform
from ..solvers.multi_view_pnp import SpacePoints, multi_view_pnp
from ..solvers.pnp import keypoints_covariance
from ..solvers.reprojection import PnpResult
from ..solvers.rigid import solve_pose
from ..solvers.triangulation import triangulate
from ..symmetry import keypoint_permutations
from ..types import PoseEstimate
from .frontend import EncodedView

_OUTLIER_ERROR = 8.0
"""Outlier threshold: larger reprojection errors, in grid pixels, are clipped."""

_MAX_DEPTH_RATIO = 1.5
"""Between the depths of a fused and the previous pose; above, the fused one is rejected."""

_MIN_STD = 0.02
"""Added to the standard deviation of a method's keypoints in a refinement, in diameters."""


def consistent_views(
    encoded: Sequence[EncodedView], model: ObjectModel
) -> tuple[list[EncodedView], np.ndarray]:
    """Permutes the votes of the further views to the equivalent pose of the reference view.

    Args:
        encoded: one view or more, the reference first.
        model: the object.

    Returns:
        The views, and the keypoints (9, 3) triangulated from the reference and the last view, in
        the reference camera, meters; (0, 3) of a single view.
    """
    permutations = keypoint_permutations(model.keypoints, model.symmetries)
    reference = encoded[0]
    T_ref_world = invert(reference.view.T_cam_world)
    agreed, points = [reference], np.empty((0, 3))
    for view in encoded[1:]:
        best, chosen = np.inf, permutations[0]
        Ks = [reference.K_grid, view.K_grid]
        cameras = [reference.view.T_cam_world, view.view.T_cam_world]
        for permutation in permutations:
            means = np.stack([reference.vote_mean, view.vote_mean[permutation]])
            covariances = np.stack([reference.vote_covariance, view.vote_covariance[permutation]])
            candidate, _ = triangulate(means, covariances, Ks, cameras)
            residual = 0.0
            for K, camera, mean in zip(Ks, cameras, means, strict=True):
                seen = transform(camera @ T_ref_world, candidate)
                error = np.linalg.norm(project(seen, K) - mean, axis=1)
                residual += float(np.minimum(error, _OUTLIER_ERROR).sum())
            if residual < best:
                best, chosen, points = residual, permutation, candidate
        votes = ("vote_mean", "vote_covariance", "vote_score")
        agreed.append(replace(view, **{name: getattr(view, name)[chosen] for name in votes}))
    return agreed, points


def fit_joint_pose(
    views: Sequence[EncodedView], points: np.ndarray, model: ObjectModel, first: PoseEstimate
) -> PoseEstimate:
    """Fits one pose to the votes of all views.

    It starts from ``first`` and from the triangulated keypoints, which alone are decimeters off at
    a baseline of a few centimeters.

    Args:
        views: consistently labeled, see :func:`consistent_views`; of one alone, ``first`` is
            returned.
        points: triangulated keypoints (9, 3).
        model: the object.
        first: the best pose so far, also returned if the fit is not consistent with it.
    """
    if len(views) == 1:
        return first
    starts = [first.T_cam_obj, solve_pose(model.keypoints, points, model.diameter)]
    found = _fit(views, model, starts)
    T = found.T_cam_obj
    if not _depth_is_consistent(T, first, model):
        return first
    return PoseEstimate(
        T_cam_obj=T,
        keypoints=transform(T, model.keypoints),
        keypoint_covariance=keypoints_covariance(T, model.keypoints, found.covariance),
    )


def refined_by_votes(
    pose: PoseEstimate,
    views: Sequence[EncodedView],
    model: ObjectModel,
    joint: PoseEstimate,
    first: PoseEstimate,
    *,
    with_keypoints: bool,
) -> PoseEstimate:
    """Fits the pose of a method to the votes of all views and its own keypoints together.

    Args:
        pose: of the method, with its keypoints and their covariances.
        views: consistently labeled.
        model: the object.
        joint: the pose from the votes alone, which the result falls back on.
        first: the best pose before it.
        with_keypoints: whether the keypoints add to what the votes know.
    """
    points = None
    if with_keypoints:
        floor = (_MIN_STD * model.diameter) ** 2 * np.eye(3)
        points = SpacePoints(pose.keypoints, pose.keypoint_covariance + floor)
    T = _fit(views, model, [pose.T_cam_obj, joint.T_cam_obj], points).T_cam_obj
    if not _depth_is_consistent(T, first, model):
        T = joint.T_cam_obj
    return replace(pose, T_cam_obj=T, keypoints=transform(T, model.keypoints))


def _depth_is_consistent(T_cam_obj: np.ndarray, first: PoseEstimate, model: ObjectModel) -> bool:
    """Whether a fused pose has about the depth of the best pose before it.

    Views of different things, after a wrong detection, fit an object that is meters away.
    """
    depth = float(transform(T_cam_obj, model.keypoints[-1])[2])
    before = float(transform(first.T_cam_obj, model.keypoints[-1])[2])
    return bool(before / _MAX_DEPTH_RATIO < depth < before * _MAX_DEPTH_RATIO)


def _fit(
    views: Sequence[EncodedView],
    model: ObjectModel,
    starts: Sequence[np.ndarray],
    points: SpacePoints | None = None,
) -> PnpResult:
    """Fits the pose to votes, and to 3D keypoints if given, from initial poses ``starts``."""
    return multi_view_pnp(
        model.keypoints,
        np.stack([e.vote_mean for e in views]),
        np.stack([e.vote_covariance for e in views]),
        [e.K_grid for e in views],
        [e.view.T_cam_world for e in views],
        starts,
        points,
    )
