"""Least-squares triangulation from two or more views, with covariances.

The rays of the pixels are intersected by least squares, and the intersection is refined by
Gauss-Newton on the Mahalanobis reprojection error in all views (Hartley and Zisserman, *Multiple
View Geometry*, chapter 12, with a covariance for each pixel). Where the rays are parallel the
depth is unobservable: a weak prior keeps the point finite, and its covariance is large.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError
from ...core.geometry import invert
from .reprojection import Rig, check_cameras, whiteners

MIN_DEPTH = 0.05
"""Smallest depth in meters of a point in every view, where the views allow it."""

MAX_DEPTH = 10.0
"""Largest depth in meters: a table-top scene has nothing further."""

_NOMINAL_DEPTH = 1.0
"""Depth in meters of a point whose rays do not determine it."""

PRIOR_STD = 10.0
"""Standard deviation in meters of the prior on a point."""

_ITERATIONS = 8


def triangulate(
    pixels: np.ndarray,
    covariances: np.ndarray,
    Ks: Sequence[np.ndarray],
    T_cam_world: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Triangulates points by minimizing the Mahalanobis reprojection error in all views.

    Args:
        pixels: (V, N, 2), the same N points in V >= 2 views; NaN where a view does not see a point.
        covariances: of the pixels, (V, N, 2, 2), pixels squared.
        Ks: V camera matrices, (3, 3) each.
        T_cam_world: V transforms, (4, 4) each, meters. The world is any frame they share.

    Returns:
        Points (N, 3) in the frame of the first camera, meters, and their covariances (N, 3, 3).
        Both are always finite.

    Raises:
        InputError: if shapes do not match, there are fewer than two views, or a camera is invalid.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    covariances = np.asarray(covariances, dtype=np.float64)
    cameras, T_view_first = check_cameras(pixels, covariances, Ks, T_cam_world)
    if len(pixels) < 2:
        raise InputError(f"triangulation needs V >= 2 views, got {len(pixels)}")
    problem = _PointRig(
        pixels=np.nan_to_num(pixels, posinf=0.0, neginf=0.0),
        whiteners=whiteners(pixels, covariances),
        Ks=cameras,
        T_view_first=T_view_first,
    )
    points = _refine(problem, _intersect_rays(problem))
    _, information = problem.normal_equations(points)
    # The second term keeps the matrix regular despite rounding.
    ridge = 1 / PRIOR_STD**2 + 1e-13 * np.trace(information, axis1=1, axis2=2)
    return points, np.linalg.inv(information + ridge[:, None, None] * np.eye(3))


@dataclass(frozen=True, eq=False)
class _PointRig(Rig):
    """The squared Mahalanobis errors of each point, without a Huber weight."""

    def cost(self, points: np.ndarray) -> np.ndarray:
        """Squared Mahalanobis errors (N,); infinite out of the depth range of a seeing camera."""
        seen = self.in_views(points)
        out = ((seen[..., 2] < MIN_DEPTH) | (seen[..., 2] > MAX_DEPTH)) & self.sees
        return np.where(out.any(axis=0), np.inf, (self.residuals(seen) ** 2).sum(axis=(0, 2)))

    def normal_equations(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (N, 3) and Gauss-Newton matrix (N, 3, 3)."""
        seen = self.in_views(points)
        jacobian, residuals = self.jacobians(seen), self.residuals(seen)
        gradient = np.einsum("vnij,vni->nj", jacobian, residuals)
        return gradient, np.einsum("vnij,vnik->njk", jacobian, jacobian)


def _intersect_rays(rig: _PointRig) -> np.ndarray:
    """Least-squares intersection of the rays, (N, 3); parallel rays: at the nominal depth."""
    T_first_view = invert(rig.T_view_first)
    homogeneous = np.concatenate([rig.pixels, np.ones_like(rig.pixels[..., :1])], axis=-1)
    rays = homogeneous @ np.linalg.inv(rig.Ks).transpose(0, 2, 1)
    rays = rays @ T_first_view[:, :3, :3].transpose(0, 2, 1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    centers = T_first_view[:, None, :3, 3]
    # I - r r^T projects onto the plane normal to a ray r. Precise pixels weigh more.
    precision = (rig.whiteners**2).sum(axis=(2, 3))
    precision = precision / np.maximum(precision.sum(axis=0), 1e-12)
    projectors = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    weighted = precision[..., None, None] * projectors
    anchor = _at_depth(rig, rays, centers, _NOMINAL_DEPTH)
    matrix = weighted.sum(axis=0) + 1e-7 * np.eye(3)
    target = np.einsum("vnij,vnj->ni", weighted, np.broadcast_to(centers, rays.shape))
    points = np.linalg.solve(matrix, (target + 1e-7 * anchor)[..., None])[..., 0]

    # Replace intersections behind a camera or too far away by the best depth along one ray.
    cost = rig.cost(points)
    lost = ~np.isfinite(cost)
    if lost.any():
        depths = np.geomspace(0.1, 0.9 * MAX_DEPTH, 16)
        tries = np.stack([_at_depth(rig, rays, centers, depth) for depth in depths])
        costs = np.stack([rig.cost(candidate) for candidate in tries])
        best = tries[costs.argmin(axis=0), np.arange(len(points))]
        best = np.where(np.isfinite(costs.min(axis=0))[:, None], best, anchor)
        points = np.where(lost[:, None], best, points)
    return points


def _at_depth(rig: _PointRig, rays: np.ndarray, centers: np.ndarray, depth: float) -> np.ndarray:
    """Points (N, 3) at a distance along the ray of the first view that has a usable pixel."""
    first = rig.sees.argmax(axis=0)
    points = centers[first, 0] + depth * rays[first, np.arange(rays.shape[1])]
    points[:, 2] = np.maximum(points[:, 2], MIN_DEPTH)
    return points


def _refine(rig: _PointRig, points: np.ndarray) -> np.ndarray:
    """Levenberg-Marquardt of all points at once; none gets worse, or behind a camera."""
    cost = rig.cost(points)
    damping = np.full(len(points), 1e-6)
    for _ in range(_ITERATIONS):
        gradient, information = rig.normal_equations(points)
        # Scaled by the diagonal, with an absolute part for unconstrained directions.
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
