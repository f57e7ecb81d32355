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

from .geometry import check_intrinsics, check_rigid, invert
from .pnp import projection_jacobian, whiteners

NEAREST = 0.05
"""Least depth in metres of a point in every view, where the views allow it."""

FARTHEST = 10.0
"""Largest depth in metres: a table-top scene has nothing further."""

_NOMINAL_DEPTH = 1.0
"""Depth in metres at which a point is put if its rays do not say."""

PRIOR = 10.0
"""Standard deviation in metres of what is known of a point before it is seen."""

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
        T_cam_world: V transforms, (4, 4) each, metres. The world is any frame they share.

    Returns:
        Points (N, 3) in the frame of the first camera, metres, and their covariances (N, 3, 3).
        Both are finite always.

    Raises:
        ValueError: if shapes do not match, there are fewer than two views, or a camera is invalid.
    """
    pixels = np.asarray(pixels, dtype=np.float64)
    covariances = np.asarray(covariances, dtype=np.float64)
    cameras, T_view_first = check_cameras(pixels, covariances, Ks, T_cam_world)
    views, count = pixels.shape[:2]
    white = whiteners(pixels.reshape(-1, 2), covariances.reshape(-1, 2, 2))
    problem = _Rig(
        pixels=np.nan_to_num(pixels, posinf=0.0, neginf=0.0),
        whiteners=white.reshape(views, count, 2, 2),
        cameras=cameras,
        rotations=T_view_first[:, :3, :3],
        translations=T_view_first[:, :3, 3],
    )
    points = _start(problem, T_view_first)
    points = _refine(problem, points)
    _, information = problem.normal_equations(points)
    # The second part keeps what rounding would make singular.
    least = 1 / PRIOR**2 + 1e-13 * np.trace(information, axis1=1, axis2=2)
    return points, np.linalg.inv(information + least[:, None, None] * np.eye(3))


@dataclass(frozen=True, eq=False)
class _Rig:
    """V cameras that look at N points; everything in the frame of the first.

    Attributes:
        pixels: (V, N, 2).
        whiteners: (V, N, 2, 2), W^T W = Sigma^-1, or zero where a view does not see a point.
        cameras: (V, 3, 3), camera matrices.
        rotations: (V, 3, 3), first camera to each.
        translations: (V, 3), metres.
    """

    pixels: np.ndarray
    whiteners: np.ndarray
    cameras: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray

    def in_views(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3) in each camera's frame, (V, N, 3)."""
        return points @ self.rotations.transpose(0, 2, 1) + self.translations[:, None]

    def residuals(self, seen: np.ndarray) -> np.ndarray:
        """Whitened reprojection errors (V, N, 2) of points in the cameras' frames."""
        depth = np.maximum(seen[..., 2:], 1e-3)  # a point behind a camera costs, and stays finite
        uv = (seen @ self.cameras.transpose(0, 2, 1))[..., :2] / depth
        return (self.whiteners @ (uv - self.pixels)[..., None])[..., 0]

    def cost(self, points: np.ndarray) -> np.ndarray:
        """Squared Mahalanobis error of each point, (N,).

        It is infinite for a point out of the depth range of a camera that sees it.
        """
        seen = self.in_views(points)
        out = ((seen[..., 2] < NEAREST) | (seen[..., 2] > FARTHEST)) & self.sees
        return np.where(out.any(axis=0), np.inf, (self.residuals(seen) ** 2).sum(axis=(0, 2)))

    @property
    def sees(self) -> np.ndarray:
        """Which view has a usable pixel of which point, (V, N)."""
        return np.any(self.whiteners, axis=(2, 3))

    def normal_equations(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (N, 3) and Gauss-Newton matrix (N, 3, 3)."""
        seen = self.in_views(points)
        seen[..., 2] = np.maximum(seen[..., 2], 1e-3)
        jacobian = np.stack(
            [
                white @ projection_jacobian(view, K) @ rotation
                for white, view, K, rotation in zip(
                    self.whiteners, seen, self.cameras, self.rotations, strict=True
                )
            ]
        )
        residuals = self.residuals(seen)
        gradient = np.einsum("vnij,vni->nj", jacobian, residuals)
        return gradient, np.einsum("vnij,vnik->njk", jacobian, jacobian)


def _start(rig: _Rig, T_view_first: np.ndarray) -> np.ndarray:
    """Least-squares intersection of the rays, (N, 3); parallel rays stop at the nominal depth."""
    T_first_view = invert(T_view_first)
    homogeneous = np.concatenate([rig.pixels, np.ones_like(rig.pixels[..., :1])], axis=-1)
    rays = homogeneous @ np.linalg.inv(rig.cameras).transpose(0, 2, 1)
    rays = rays @ T_first_view[:, :3, :3].transpose(0, 2, 1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    centres = T_first_view[:, None, :3, 3]
    # The distance to a ray is that to its projector's null space. Sharp pixels count for more.
    sharpness = (rig.whiteners**2).sum(axis=(2, 3))
    sharpness = sharpness / np.maximum(sharpness.sum(axis=0), 1e-12)
    projectors = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    weighted = sharpness[..., None, None] * projectors
    anchor = _at_depth(rig, rays, centres, _NOMINAL_DEPTH)
    matrix = weighted.sum(axis=0) + 1e-7 * np.eye(3)
    target = np.einsum("vnij,vnj->ni", weighted, np.broadcast_to(centres, rays.shape))
    points = np.linalg.solve(matrix, (target + 1e-7 * anchor)[..., None])[..., 0]

    # An intersection behind a camera, or far off, is none: take the best depth on one ray.
    cost = rig.cost(points)
    lost = ~np.isfinite(cost)
    if lost.any():
        tries = np.stack(
            [
                _at_depth(rig, rays, centres, depth)
                for depth in np.geomspace(0.1, 0.9 * FARTHEST, 16)
            ]
        )
        costs = np.stack([rig.cost(candidate) for candidate in tries])
        best = tries[costs.argmin(axis=0), np.arange(len(points))]
        best = np.where(np.isfinite(costs.min(axis=0))[:, None], best, anchor)
        points = np.where(lost[:, None], best, points)
    return points


def _at_depth(rig: _Rig, rays: np.ndarray, centres: np.ndarray, depth: float) -> np.ndarray:
    """Points (N, 3) at a distance along the ray of the first view that has a usable pixel."""
    first = rig.sees.argmax(axis=0)
    index = np.arange(rays.shape[1])
    points = centres[first, 0] + depth * rays[first, index]
    points[:, 2] = np.maximum(points[:, 2], NEAREST)
    return points


def _refine(rig: _Rig, points: np.ndarray) -> np.ndarray:
    """Levenberg-Marquardt of all points at once; none gets worse, or behind a camera."""
    cost = rig.cost(points)
    damping = np.full(len(points), 1e-6)
    for _ in range(_ITERATIONS):
        gradient, information = rig.normal_equations(points)
        # Scaled by the diagonal, with an absolute part for directions that nothing constrains.
        diagonal = damping[:, None] * np.einsum("nii->ni", information) + 1 / PRIOR**2
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
        raise ValueError(f"pixels must be (V, N, 2) with V >= 2 views, got shape {pixels.shape}")
    if covariances.shape != (*pixels.shape, 2):
        raise ValueError(
            f"covariances must be {(*pixels.shape, 2)} to match pixels, got {covariances.shape}"
        )
    views = len(pixels)
    if len(Ks) != views or len(T_cam_world) != views:
        raise ValueError(
            f"Ks and T_cam_world must have one entry for each of the {views} views, "
            f"got {len(Ks)} and {len(T_cam_world)}"
        )
    cameras = np.stack([check_intrinsics(K, f"Ks[{i}]") for i, K in enumerate(Ks)])
    poses = np.stack([check_rigid(T, f"T_cam_world[{i}]") for i, T in enumerate(T_cam_world)])
    return cameras, poses @ invert(poses[0])
