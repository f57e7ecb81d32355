"""Makes the votes of several views of a symmetric object consistent, and fits one pose to them.

Each view may vote for another of the equivalent poses. A symmetry permutes the keypoints, so the
permutation that triangulates best is taken.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.geometry import invert, project, transform
from ..solvers.multi_view_pnp import SpacePoints, multi_view_pnp
from ..solvers.rigid import solve_pose
from ..solvers.triangulation import triangulate
from ..symmetry import keypoint_permutations
from ..types import PoseEstimate
from .frontend import EncodedView

_OUTLIER_ERROR = 8.0
"""Outlier threshold: larger reprojection errors, in grid pixels, are clipped."""

_MAX_DEPTH_RATIO = 1.5
"""Between the depths of a fused and the previous pose; above, the fused one is rejected."""


def resolve_symmetry_ambiguity(
    encoded: Sequence[EncodedView], model: ObjectModel
) -> tuple[list[EncodedView], np.ndarray]:
    """Permutes the votes of the further views to the equivalent pose of the reference view.

    Args:
        encoded: two views or more, the reference first.
        model: the object.

    Returns:
        The views, and the keypoints (9, 3) triangulated from the reference and the last view, in
        the reference camera, meters.
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


def joint_pose(
    encoded: Sequence[EncodedView], points: np.ndarray, model: ObjectModel, first: PoseEstimate
) -> np.ndarray:
    """Fits T_cam_obj (4, 4), in the reference camera, to the votes of all views.

    It starts from ``first`` and from the triangulated keypoints, which alone are decimeters off at
    a baseline of a few centimeters.

    Args:
        encoded: the views, consistently labeled.
        points: triangulated keypoints (9, 3).
        model: the object.
        first: the best pose so far, also returned if the fit is not consistent with it.
    """
    starts = [first.T_cam_obj, solve_pose(model.keypoints, points, model.diameter)]
    T = fit_multi_view_pose(encoded, model, starts)
    return T if depth_is_consistent(T, first, model) else first.T_cam_obj


def depth_is_consistent(T_cam_obj: np.ndarray, first: PoseEstimate, model: ObjectModel) -> bool:
    """Whether a fused pose has about the depth of the best pose before it.

    Views of different things, after a wrong detection, fit an object that is meters away.
    """
    depth = float(transform(T_cam_obj, model.keypoints[-1])[2])
    before = float(transform(first.T_cam_obj, model.keypoints[-1])[2])
    return bool(before / _MAX_DEPTH_RATIO < depth < before * _MAX_DEPTH_RATIO)


def fit_multi_view_pose(
    encoded: Sequence[EncodedView],
    model: ObjectModel,
    starts: Sequence[np.ndarray],
    points: SpacePoints | None = None,
) -> np.ndarray:
    """Fits the pose (4, 4) to votes, and to 3D keypoints if given.

    Args:
        encoded: the views, the reference first, consistently labeled.
        model: the object.
        starts: initial poses in the reference camera.
        points: 3D keypoints from a fusion.
    """
    return multi_view_pnp(
        model.keypoints,
        np.stack([e.vote_mean for e in encoded]),
        np.stack([e.vote_covariance for e in encoded]),
        [e.K_grid for e in encoded],
        [e.view.T_cam_world for e in encoded],
        starts,
        points,
    ).T_cam_obj
