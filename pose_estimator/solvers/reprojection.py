"""Reprojection errors of several views, weighted by covariances, and the pose that minimizes them.

Residuals are Mahalanobis distances between projected and measured pixels. Poses are found by
Levenberg-Marquardt with analytic Jacobians and Huber weights. A pose is perturbed on the left, in
the camera's axes and about the object's origin: X = exp(w) R m + t + v, so a pose covariance is
that of (w, v), radians and meters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...core.errors import InputError
from ...core.geometry import check_intrinsics, check_rigid, invert, make_transform

MIN_POINT_DEPTH = 0.01
"""Smallest depth in meters of a keypoint in every view."""

_HUBER = 2.0
"""Huber threshold, a Mahalanobis distance."""

_MIN_DIVISOR = 1e-3
"""Smallest depth in meters by which a projection divides."""

_ITERATIONS = 12


@dataclass(frozen=True, eq=False)
class PnpResult:
    """A pose from 2D keypoints.

    Attributes:
        T_cam_obj: (4, 4), meters.
        covariance: (6, 6) of the left perturbation (rotation in radians, translation in meters).
        cost: half the robust sum of squared Mahalanobis distances.
    """

    T_cam_obj: np.ndarray
    covariance: np.ndarray
    cost: float


@dataclass(frozen=True, eq=False)
class Rig:
    """V cameras that observe N points; everything in the frame of the first.

    Attributes:
        pixels: (V, N, 2).
        whiteners: (V, N, 2, 2), W^T W = Sigma^-1, or zero where a view does not see a point.
        Ks: (V, 3, 3), camera matrices.
        T_view_first: (V, 4, 4), first camera to each, meters.
    """

    pixels: np.ndarray
    whiteners: np.ndarray
    Ks: np.ndarray
    T_view_first: np.ndarray

    @property
    def sees(self) -> np.ndarray:
        """Whether each view observes each point, (V, N)."""
        return np.any(self.whiteners, axis=(2, 3))

    def in_views(self, points: np.ndarray) -> np.ndarray:
        """Transforms points (N, 3) of the first camera to each camera's frame, (V, N, 3)."""
        rotations = self.T_view_first[:, :3, :3].transpose(0, 2, 1)
        return points @ rotations + self.T_view_first[:, None, :3, 3]

    def residuals(self, seen: np.ndarray) -> np.ndarray:
        """Whitened reprojection errors (V, N, 2) of points in the cameras' frames (V, N, 3)."""
        # A point behind a camera has a large but finite error.
        depth = np.maximum(seen[..., 2:], _MIN_DIVISOR)
        errors = (seen @ self.Ks.transpose(0, 2, 1))[..., :2] / depth - self.pixels
        return self.whiten(errors)

    def whiten(self, errors: np.ndarray) -> np.ndarray:
        """Whitens errors (V, N, 2) in pixels: their norms become Mahalanobis distances."""
        return (self.whiteners @ errors[..., None])[..., 0]

    def jacobians(self, seen: np.ndarray) -> np.ndarray:
        """Derivatives (V, N, 2, 3) of :meth:`residuals` in the points of the first camera."""
        x, y, z = np.moveaxis(seen, -1, 0)
        seen = np.stack([x, y, np.maximum(z, _MIN_DIVISOR)], axis=-1)
        rotations = self.T_view_first[:, None, :3, :3]
        return self.whiteners @ projection_jacobian(seen, self.Ks) @ rotations


@dataclass(frozen=True, eq=False)
class ReprojectionProblem(Rig):
    """The Huber cost of a pose's reprojection errors; ``model_points`` are (N, 3)."""

    model_points: np.ndarray

    def cost(self, rotation: np.ndarray, translation: np.ndarray) -> float:
        """Huber cost; infinite unless the object is in front of every camera."""
        seen = self.in_views(self.model_points @ rotation.T + translation)
        if not seen[..., 2].min() > MIN_POINT_DEPTH:
            return np.inf
        return huber_cost(self.residuals(seen).reshape(-1, 2))

    def normal_equations(
        self, rotation: np.ndarray, translation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (6,) and Gauss-Newton matrix (6, 6) of the Huber cost."""
        rotated = self.model_points @ rotation.T
        seen = self.in_views(rotated + translation)
        jacobian = self.jacobians(seen) @ point_jacobian(rotated)
        return robust_normal_equations(
            self.residuals(seen).reshape(-1, 2), jacobian.reshape(-1, 2, 6)
        )


def refine(
    problem: ReprojectionProblem, rotation: np.ndarray, translation: np.ndarray
) -> PnpResult:
    """Levenberg-Marquardt from a rotation (3, 3) and a translation (3,)."""
    cost = problem.cost(rotation, translation)
    damping = 1e-3
    gradient, information = problem.normal_equations(rotation, translation)
    for _ in range(_ITERATIONS):
        damped = information + np.diag(damping * information.diagonal() + 1e-9)
        step = -np.linalg.solve(damped, gradient)
        increment, _ = cv2.Rodrigues(step[:3])
        new_rotation, new_translation = increment @ rotation, translation + step[3:]
        new_cost = problem.cost(new_rotation, new_translation)
        if new_cost <= cost:
            converged = cost - new_cost < 1e-6 * cost + 1e-12
            rotation, translation, cost = new_rotation, new_translation, new_cost
            gradient, information = problem.normal_equations(rotation, translation)
            damping *= 0.1
            if converged:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    # The prior of one radian and one meter bounds unobservable directions.
    covariance = np.linalg.inv(information + np.eye(6))
    return PnpResult(make_transform(rotation, translation), covariance, float(cost))


def huber_cost(residuals: np.ndarray) -> float:
    """Huber cost of whitened residuals (N, D)."""
    distances = np.sqrt((residuals**2).sum(axis=1))
    far = distances > _HUBER
    return float(np.where(far, _HUBER * (distances - 0.5 * _HUBER), 0.5 * distances**2).sum())


def robust_normal_equations(
    residuals: np.ndarray, jacobian: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient (6,) and Gauss-Newton matrix (6, 6) of the Huber cost.

    ``residuals`` are whitened, (N, D), with derivatives ``jacobian`` (N, D, 6).
    """
    distances = np.sqrt((residuals**2).sum(axis=1))
    weights = np.minimum(1.0, _HUBER / np.maximum(distances, 1e-12))
    weighted = (weights[:, None, None] * jacobian).reshape(-1, 6)
    return weighted.T @ residuals.ravel(), weighted.T @ jacobian.reshape(-1, 6)


def projection_jacobian(points: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Derivative (..., 2, 3) of ``geometry.project`` in points of the camera's frame.

    Takes points (..., 3) and K (3, 3), or (V, N, 3) and (V, 3, 3).
    """
    uvw = points @ K.swapaxes(-1, -2)
    rows = K if K.ndim == 2 else K[:, None]
    depth = uvw[..., 2, None, None]
    return (rows[..., :2, :] - (uvw[..., :2] / uvw[..., 2:])[..., None] * rows[..., 2:, :]) / depth


def point_jacobian(rotated: np.ndarray) -> np.ndarray:
    """Derivative (N, 3, 6) of exp(w) r + t + v in (w, v): [-[r]x, I]."""
    jacobian = np.zeros((len(rotated), 3, 6))
    x, y, z = rotated.T
    jacobian[:, 0, 1], jacobian[:, 0, 2] = z, -y
    jacobian[:, 1, 0], jacobian[:, 1, 2] = -z, x
    jacobian[:, 2, 0], jacobian[:, 2, 1] = y, -x
    jacobian[:, 0, 3] = jacobian[:, 1, 4] = jacobian[:, 2, 5] = 1.0
    return jacobian


def whiteners(pixels: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Whitening matrices: W (..., 2, 2) with W^T W = Sigma^-1, by a closed-form Cholesky factor.

    Zero where a pixel (..., 2) or its covariance (..., 2, 2) is not finite.
    """
    usable = np.isfinite(pixels).all(axis=-1) & np.isfinite(covariances).all(axis=(-2, -1))
    covariances = np.where(usable[..., None, None], covariances, np.eye(2))
    # No detector is more precise than a thousandth of a pixel.
    a = np.maximum(covariances[..., 0, 0], 1e-6)
    d = np.maximum(covariances[..., 1, 1], 1e-6)
    b = 0.5 * (covariances[..., 0, 1] + covariances[..., 1, 0])
    b = np.clip(b, -0.999 * np.sqrt(a * d), 0.999 * np.sqrt(a * d))
    whiteners = np.zeros_like(covariances)
    first = np.sqrt(a)
    second = np.sqrt(d - b**2 / a)
    whiteners[..., 0, 0] = 1 / first
    whiteners[..., 1, 0] = -b / (a * second)
    whiteners[..., 1, 1] = 1 / second
    whiteners[~usable] = 0.0
    return whiteners


def check_cameras(
    pixels: np.ndarray,
    covariances: np.ndarray,
    Ks: Sequence[np.ndarray],
    T_cam_world: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Checks all shapes; returns K of each view (V, 3, 3) and T_view_first (V, 4, 4)."""
    if pixels.ndim != 3 or pixels.shape[2] != 2:
        raise InputError(f"pixels must be (V, N, 2), got shape {pixels.shape}")
    if covariances.shape != (*pixels.shape, 2):
        raise InputError(
            f"covariances must be {(*pixels.shape, 2)} to match pixels, got {covariances.shape}"
        )
    views = len(pixels)
    if not len(Ks) == len(T_cam_world) == views > 0:
        raise InputError(
            f"Ks and T_cam_world must have one entry for each of the {views} views, "
            f"got {len(Ks)} and {len(T_cam_world)}"
        )
    cameras = np.stack([check_intrinsics(K, f"Ks[{i}]") for i, K in enumerate(Ks)])
    poses = np.stack([check_rigid(T, f"T_cam_world[{i}]") for i, T in enumerate(T_cam_world)])
    return cameras, poses @ invert(poses[0])
