"""One pose from the votes of several views: uncertainty-driven PnP in all of them at once.

The model's shape and the cameras' relative poses are both used, so the answer holds for any
baseline: where the views stand close together the object's size gives the depth, where they stand
far apart the parallax does. Triangulation alone has only the second. Keypoints that a fusion found
in space may be explained together with the votes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .geometry import check_intrinsics, check_rigid, invert, make_transform
from .pnp import (
    NEAREST_POINT,
    PnpProblem,
    PnpResult,
    huber_cost,
    point_jacobian,
    projection_jacobian,
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
    """The pose that best explains the keypoints of all views, each as far as it can be trusted.

    Args:
        model_points: (N, 3) in the object's frame, metres, N >= 4.
        pixels: (V, N, 2).
        covariances: of the pixels, (V, N, 2, 2), pixels squared.
        Ks: V camera matrices, (3, 3) each.
        T_cam_world: V transforms, (4, 4) each, metres. The world is any frame they share.
        starts: poses T_cam_obj (4, 4) in the first camera to start from; the best end is taken.
        points: the keypoints as they were found in space, which are to be explained as well.

    Returns:
        The pose in the first camera. Where no start lies in front of all cameras, the first start,
        with a covariance of a radian and a metre and an infinite cost.

    Raises:
        ValueError: if shapes do not match, a camera is invalid or there is no start.
    """
    count = len(model_points)
    if np.shape(pixels) != (len(Ks), count, 2) or np.shape(covariances) != (len(Ks), count, 2, 2):
        raise ValueError(
            f"pixels and covariances must be {(len(Ks), count, 2)} and {(len(Ks), count, 2, 2)} "
            f"for {len(Ks)} cameras, got {np.shape(pixels)} and {np.shape(covariances)}"
        )
    if len(T_cam_world) != len(Ks) or not len(starts):
        raise ValueError(f"needs {len(Ks)} camera poses and a start, got {len(T_cam_world)} poses")
    cameras = np.stack([check_rigid(T, f"T_cam_world[{i}]") for i, T in enumerate(T_cam_world)])
    problem: PnpProblem = _Problem(
        model_points=np.asarray(model_points, dtype=np.float64),
        pixels=np.nan_to_num(np.asarray(pixels, dtype=np.float64), posinf=0, neginf=0),
        Ks=np.stack([check_intrinsics(K, f"Ks[{i}]") for i, K in enumerate(Ks)]),
        T_view_first=cameras @ invert(cameras[0]),
        whiteners=np.stack([whiteners(*pair) for pair in zip(pixels, covariances, strict=True)]),
    )
    if points is not None:
        if points.mean.shape != (count, 3) or points.covariance.shape != (count, 3, 3):
            raise ValueError(
                f"points must be {(count, 3)} with covariances {(count, 3, 3)}, got "
                f"{points.mean.shape} and {points.covariance.shape}"
            )
        precision = np.linalg.inv(points.covariance)
        root = np.linalg.cholesky(0.5 * (precision + precision.transpose(0, 2, 1)))
        problem = _WithPoints(problem, model_points, points.mean, root.transpose(0, 2, 1))
    best = PnpResult(np.array(starts[0], dtype=np.float64), np.eye(6), np.inf)
    for start in starts:
        rotation, translation = start[:3, :3], start[:3, 3]
        if not np.isfinite(problem.cost(rotation, translation)):
            continue
        rotation, translation, cost, information = refine(problem, rotation, translation)
        if cost < best.cost:
            covariance = np.linalg.inv(information + np.eye(6))
            best = PnpResult(make_transform(rotation, translation), covariance, float(cost))
    return best


@dataclass(frozen=True, eq=False)
class SpacePoints:
    """Keypoints that were found in space.

    Attributes:
        mean: (N, 3) in the first camera, metres.
        covariance: (N, 3, 3), square metres, positive definite.
    """

    mean: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class _WithPoints:
    """A problem, and the Mahalanobis distances from points in space, each with a Huber weight.

    Attributes:
        problem: the reprojection errors.
        model_points: (N, 3).
        mean: (N, 3).
        whiteners: (N, 3, 3) W with W^T W the inverse covariance.
    """

    problem: PnpProblem
    model_points: np.ndarray
    mean: np.ndarray
    whiteners: np.ndarray

    def _residuals(self, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
        offset = self.model_points @ rotation.T + translation - self.mean
        return (self.whiteners @ offset[..., None])[..., 0]

    def cost(self, rotation: np.ndarray, translation: np.ndarray) -> float:
        """Huber cost of both; infinite unless the object is in front of every camera."""
        cost = self.problem.cost(rotation, translation)
        if not np.isfinite(cost):
            return cost
        return cost + huber_cost(self._residuals(rotation, translation))

    def normal_equations(
        self, rotation: np.ndarray, translation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (6,) and Gauss-Newton matrix (6, 6) of the Huber cost of both."""
        gradient, information = self.problem.normal_equations(rotation, translation)
        jacobian = self.whiteners @ point_jacobian(self.model_points @ rotation.T)
        more = robust_normal_equations(self._residuals(rotation, translation), jacobian)
        return gradient + more[0], information + more[1]


@dataclass(frozen=True, eq=False)
class _Problem:
    """Model (N, 3); for V views: pixels, Ks, transforms from the first, and whiteners as in PnP."""

    model_points: np.ndarray
    pixels: np.ndarray
    Ks: np.ndarray
    T_view_first: np.ndarray
    whiteners: np.ndarray

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3) of the first camera in each camera, (V, N, 3)."""
        rotations = self.T_view_first[:, :3, :3].transpose(0, 2, 1)
        return points @ rotations + self.T_view_first[:, None, :3, 3]

    def residuals(self, seen: np.ndarray) -> np.ndarray:
        """Whitened reprojection errors (V N, 2)."""
        uv = seen @ self.Ks.transpose(0, 2, 1)
        errors = uv[..., :2] / uv[..., 2:] - self.pixels
        return (self.whiteners @ errors[..., None])[..., 0].reshape(-1, 2)

    def cost(self, rotation: np.ndarray, translation: np.ndarray) -> float:
        """Huber cost; infinite unless the object is in front of every camera."""
        seen = self.seen(self.model_points @ rotation.T + translation)
        if not seen[..., 2].min() > NEAREST_POINT:
            return np.inf
        return huber_cost(self.residuals(seen))

    def normal_equations(
        self, rotation: np.ndarray, translation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (6,) and Gauss-Newton matrix (6, 6) of the Huber cost."""
        rotated = self.model_points @ rotation.T
        seen = self.seen(rotated + translation)
        jacobian = np.concatenate(
            [
                whitener @ projection_jacobian(points, K) @ T[:3, :3] @ point_jacobian(rotated)
                for whitener, points, K, T in zip(
                    self.whiteners, seen, self.Ks, self.T_view_first, strict=True
                )
            ]
        )
        return robust_normal_equations(self.residuals(seen), jacobian)
