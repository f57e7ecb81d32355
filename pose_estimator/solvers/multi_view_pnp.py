"""Uncertainty-driven PnP in several views at once.

Model and relative camera poses are both used, so the pose is accurate at any baseline: at a short
one the object's size gives the depth, at a long one the parallax. Triangulation has only the
second. Keypoints that a fusion triangulated can be residuals in addition to the votes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...core.errors import InputError
from .reprojection import (
    PnpResult,
    ReprojectionProblem,
    check_cameras,
    huber_cost,
    point_jacobian,
    refine,
    robust_normal_equations,
    whiteners,
)


def multi_view_pnp(
    model_points: np.ndarray,
    pixels: np.ndarray,
    covariances: np.ndarray,
    Ks: Sequence[np.ndarray],
    T_cam_world: Sequence[np.ndarray],
    starts: Sequence[np.ndarray],
    points: SpacePoints | None = None,
) -> PnpResult:
    """Finds the pose of least Huber cost of the Mahalanobis errors in all views.

    Args:
        model_points: (N, 3) in the object's frame, meters, N >= 4.
        pixels: (V, N, 2).
        covariances: of the pixels, (V, N, 2, 2), pixels squared.
        Ks: V camera matrices, (3, 3) each.
        T_cam_world: V transforms, (4, 4) each, meters. The world is any frame they share.
        starts: initial poses T_cam_obj (4, 4) in the first camera; the best result is returned.
        points: keypoints in 3D, as additional residuals.

    Returns:
        The pose in the first camera. If no start is in front of all cameras: the first start, with
        an identity covariance and an infinite cost.

    Raises:
        InputError: if shapes do not match, a camera is invalid or there is no start.
    """
    pixels, covariances = np.asarray(pixels), np.asarray(covariances)
    cameras, T_view_first = check_cameras(pixels, covariances, Ks, T_cam_world)
    if pixels.shape[1] != len(model_points) or not len(starts):
        raise InputError(
            f"needs pixels of {len(model_points)} keypoints and a start, got {pixels.shape[1]} "
            f"keypoints and {len(starts)} starts"
        )
    problem = ReprojectionProblem(
        pixels=np.nan_to_num(pixels.astype(np.float64), posinf=0, neginf=0),
        whiteners=whiteners(pixels, covariances),
        Ks=cameras,
        T_view_first=T_view_first,
        model_points=np.asarray(model_points, dtype=np.float64),
    )
    if points is not None:
        problem = _WithPoints(**vars(problem), points=points)
    best = PnpResult(np.array(starts[0], dtype=np.float64), np.eye(6), np.inf)
    for start in starts:
        rotation, translation = start[:3, :3], start[:3, 3]
        if np.isfinite(problem.cost(rotation, translation)):
            found = refine(problem, rotation, translation)
            best = found if found.cost < best.cost else best
    return best


@dataclass(frozen=True, eq=False)
class SpacePoints:
    """Keypoints in 3D.

    Attributes:
        mean: (N, 3) in the first camera, meters.
        covariance: (N, 3, 3), square meters, positive definite.
    """

    mean: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class _WithPoints(ReprojectionProblem):
    """Adds the Mahalanobis distances from 3D points, each with a Huber weight.

    Raises:
        InputError: if there is not one point for each of the model's.
    """

    points: SpacePoints

    def __post_init__(self) -> None:
        count = len(self.model_points)
        mean, covariance = self.points.mean, self.points.covariance
        if mean.shape != (count, 3) or covariance.shape != (count, 3, 3):
            raise InputError(
                f"points must be {(count, 3)} with covariances {(count, 3, 3)}, got "
                f"{mean.shape} and {covariance.shape}"
            )

    @cached_property
    def _space_whiteners(self) -> np.ndarray:
        """(N, 3, 3) W with W^T W the inverse covariance."""
        precision = np.linalg.inv(self.points.covariance)
        root = np.linalg.cholesky(0.5 * (precision + precision.transpose(0, 2, 1)))
        return root.transpose(0, 2, 1)

    def _distances(self, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
        """Whitened offsets (N, 3) of the keypoints from the 3D points."""
        offset = self.model_points @ rotation.T + translation - self.points.mean
        return (self._space_whiteners @ offset[..., None])[..., 0]

    def cost(self, rotation: np.ndarray, translation: np.ndarray) -> float:
        cost = super().cost(rotation, translation)
        if not np.isfinite(cost):
            return cost
        return cost + huber_cost(self._distances(rotation, translation))

    def normal_equations(
        self, rotation: np.ndarray, translation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        gradient, information = super().normal_equations(rotation, translation)
        jacobian = self._space_whiteners @ point_jacobian(self.model_points @ rotation.T)
        more = robust_normal_equations(self._distances(rotation, translation), jacobian)
        return gradient + more[0], information + more[1]
