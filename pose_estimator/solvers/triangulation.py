"""Points in space from their pixels in two or more views, with covariances.

The rays of the pixels are intersected by least squares, and the intersection is refined by
Gauss-Newton on the Mahalanobis reprojection error in all views (Hartley and Zisserman, *Multiple
View Geometry*, chapter 12, with a covariance for each pixel). Where the rays are parallel their
distance is open: a weak prior then keeps the point finite, and the covariance says how little is
known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError
from ...core.geometry import check_intrinsics, check_rigid, invert
from .reprojection import Rig, whiteners

MIN_DEPTH = 0.05
"""Depth in meters of a point in every view at least, where the views allow it."""

MAX_DEPTH = 10.0
"""Largest depth in meters: a table-top scene has nothing further."""

_NOMINAL_DEPTH = 1.0
"""Depth in meters at which a point is put if its rays do not say."""

PRIOR_STD = 10.0
"""Standard deviation in meters of what is known of a point before it is seen."""

_ITERATIONS = 8


def triangulate(
    pixels: np.ndarray,
    covariances: np.ndarray,
    Ks: Sequence[np.ndarray],
    T_cam_world: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """The points that best explain their pixels in all views.

    Args:
        pixels: (V, N, 2), the same N points in V >= 2 views; NaN where a view does not see a point.
        covariances: of the pixels, (V, N, 2, 2), pixels squared.
        Ks: V camera matrices, (3, 3) each.
        T_cam_world: V transforms, (4, 4) each, meters. The world is any frame they share.

    Returns:
        Points (N, 3) in the frame of the first camera, meters, and their covariances (N, 3, 3).
        Both are finite always.

    Raises:
        InputError: if shapes do not match, there are fewer than two views, or a camera is invalid.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    covariances = np.asarray(covariances, dtype=np.float64)
    cameras, T_view_first = check_cameras(pixels, covariances, Ks, T_cam_world)
    problem = _PointRig(
        pixels=np.nan_to_num(pixels, posinf=0.0, neginf=0.0),
        whiteners=whiteners(pixels, covariances),
        Ks=cameras,
        T_view_first=T_view_first,
    )
    points = _start(problem)
    points = _refine(problem, points)
    _, information = problem.normal_equations(points)
    # The second part keeps what rounding would make singular.
    least = 1 / PRIOR_STD**2 + 1e-13 * np.trace(information, axis1=1, axis2=2)
    return points, np.linalg.inv(information + least[:, None, None] * np.eye(3))


@dataclass(frozen=True, eq=False)
class _PointRig(Rig):
    """Every point on its own: squared Mahalanobis errors, without a Huber weight."""

    def cost(self, points: np.ndarray) -> np.ndarray:
        """Squared Mahalanobis error of each point, (N,).

        It is infinite for a point out of the depth range of a camera that sees it.
        """
        seen = self.in_views(points)
        out = ((seen[..., 2] < MIN_DEPTH) | (seen[..., 2] > MAX_DEPTH)) & self.sees
        return np.where(out.any(axis=0), np.inf, (self.residuals(seen) ** 2).sum(axis=(0, 2)))

    def normal_equations(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (N, 3) and Gauss-Newton matrix (N, 3, 3)."""
        seen = self.in_views(points)
        jacobian, residuals = self.jacobians(seen), self.residuals(seen)
        gradient = np.einsum("vnij,vni->nj", jacobian, residuals)
        return gradient, np.einsum("vnij,vnik->njk", jacobian, jacobian)


def _start(rig: _PointRig) -> np.ndarray:
    """Least-squares intersection of the rays, (N, 3); parallel rays stop at the nominal depth."""
    T_first_view = invert(rig.T_view_first)
    homogeneous = np.concatenate([rig.pixels, np.ones_like(rig.pixels[..., :1])], axis=-1)
    rays = homogeneous @ np.linalg.inv(rig.Ks).transpose(0, 2, 1)
    rays = rays @ T_first_view[:, :3, :3].transpose(0, 2, 1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    centers = T_first_view[:, None, :3, 3]
    # The distance to a ray is that to its projector's null space. Sharp pixels count for more.
    sharpness = (rig.whiteners**2).sum(axis=(2, 3))
    sharpness = sharpness / np.maximum(sharpness.sum(axis=0), 1e-12)
    projectors = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    weighted = sharpness[..., None, None] * projectors
    anchor = _at_depth(rig, rays, centers, _NOMINAL_DEPTH)
    matrix = weighted.sum(axis=0) + 1e-7 * np.eye(3)
    target = np.einsum("vnij,vnj->ni", weighted, np.broadcast_to(centers, rays.shape))
    points = np.linalg.solve(matrix, (target + 1e-7 * anchor)[..., None])[..., 0]

    # An intersection behind a camera, or far off, is none: take the best depth on one ray.
    cost = rig.cost(points)
    lost = ~np.isfinite(cost)
    if lost.any():
        tries = np.stack(
            [
                _at_depth(rig, rays, centers, depth)
                for depth in np.geomspace(0.1, 0.9 * MAX_DEPTH, 16)
            ]
        )
        costs = np.stack([rig.cost(candidate) for candidate in tries])
        best = tries[costs.argmin(axis=0), np.arange(len(points))]
        best = np.where(np.isfinite(costs.min(axis=0))[:, None], best, anchor)
        points = np.where(lost[:, None], best, points)
    return points


def _at_depth(rig: _PointRig, rays: np.ndarray, centers: np.ndarray, depth: float) -> np.ndarray:
    """Points (N, 3) at a distance along the ray of the first view that has a usable pixel."""
    first = rig.sees.argmax(axis=0)
    index = np.arange(rays.shape[1])
    points = centers[first, 0] + depth * rays[first, index]
    points[:, 2] = np.maximum(points[:, 2], MIN_DEPTH)
    return points


def _refine(rig: _PointRig, points: np.ndarray) -> np.ndarray:
    """Levenberg-Marquardt of all points at once; none gets worse, or behind a camera."""
    cost = rig.cost(points)
    damping = np.full(len(points), 1e-6)
    for _ in range(_ITERATIONS):
        gradient, information = rig.normal_equations(points)
        # Scaled by the diagonal, with an absolute part for directions that nothing constrains.
        diagonal = damping[:, None] * np.einsum("nii->ni", information) + 1 / PRIOR_STD**2
        step = -np.linalg.solve(
            information + diagonal[:, :, None] * np.eye(3), gradient[..., None]
        )[..., 0]
        candidate = points + step
        new_cost = rig.cost(candidate)
        better = new_cost <= cost
        change = np.abs(step[better]).max(initial=0.0)
        points = np.where(better[:, None], candidate, points)
        cost = np.where(better, new_cost, cost)
        damping = np.where(better, damping * 0.1, np.maximum(damping, 1e-4) * 10)
        if better.all() and change < 1e-9:
            break
    return points


def check_cameras(
    pixels: np.ndarray,
    covariances: np.ndarray,
    Ks: Sequence[np.ndarray],
    T_cam_world: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Checks everything; returns K of each view (V, 3, 3) and T_view_first (V, 4, 4)."""
    if pixels.ndim != 3 or pixels.shape[2] != 2 or len(pixels) < 2:
        raise InputError(f"pixels must be (V, N, 2) with V >= 2 views, got shape {pixels.shape}")
    if covariances.shape != (*pixels.shape, 2):
        raise InputError(
            f"covariances must be {(*pixels.shape, 2)} to match pixels, got {covariances.shape}"
        )
    views = len(pixels)
    if len(Ks) != views or len(T_cam_world) != views:
        raise InputError(
            f"Ks and T_cam_world must have one entry for each of the {views} views, "
            f"got {len(Ks)} and {len(T_cam_world)}"
        )
    cameras = np.stack([check_intrinsics(K, f"Ks[{i}]") for i, K in enumerate(Ks)])
    poses = np.stack([check_rigid(T, f"T_cam_world[{i}]") for i, T in enumerate(T_cam_world)])
    return cameras, poses @ invert(poses[0])
