"""Pose from 2D keypoints and their covariances: uncertainty-driven PnP.

PVNet (Peng et al., CVPR 2019, section 3.2) minimises the Mahalanobis distance between the projected
model keypoints and the voted ones,

    sum_k (p_k - q_k)^T Sigma_k^-1 (p_k - q_k),

here by Levenberg-Marquardt with an analytic Jacobian and a Huber weight, from the better of
OpenCV's global solvers. A pose is perturbed on the left, in the camera's axes and about the
object's origin: X = exp(w) R m + t + v, so a pose covariance is that of (w, v), radians and metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from .geometry import check_intrinsics, make_transform

_NEAREST = 0.05
"""Least depth in metres of the object's origin."""

NEAREST_POINT = 0.01
"""Least depth in metres of any keypoint."""

_HUBER = 2.0
"""Mahalanobis distance from which a keypoint's pull stops growing."""

_MISFIT = 2.0
"""Mean Huber cost of a keypoint from which the first solver's answer is distrusted."""

_ITERATIONS = 12


@dataclass(frozen=True, eq=False)
class PnpResult:
    """A pose from 2D keypoints.

    Attributes:
        T_cam_obj: (4, 4), metres.
        covariance: (6, 6) of the left perturbation (rotation in radians, translation in metres).
        cost: half the robust sum of squared Mahalanobis distances.
    """

    T_cam_obj: np.ndarray
    covariance: np.ndarray
    cost: float


def uncertainty_pnp(
    model_points: np.ndarray, pixels: np.ndarray, covariances: np.ndarray, K: np.ndarray
) -> PnpResult:
    """The pose that best explains the keypoints, each as far as it can be trusted.

    Always answers with a finite pose in front of the camera, also for pixels that no pose explains.
    A keypoint whose pixel or covariance is not finite is left out.

    Args:
        model_points: (N, 3) in the object's frame, metres, N >= 4.
        pixels: (N, 2).
        covariances: of the pixels, (N, 2, 2), pixels squared.
        K: camera matrix, (3, 3).

    Raises:
        ValueError: if shapes do not match, there are fewer than 4 points, or ``K`` is no camera
            matrix.
    """
    model_points = np.asarray(model_points, dtype=np.float64)
    pixels = np.asarray(pixels, dtype=np.float64)
    covariances = np.asarray(covariances, dtype=np.float64)
    _check_shapes(model_points, pixels, covariances)
    problem = _Problem(
        model_points,
        np.nan_to_num(pixels, posinf=0, neginf=0),
        check_intrinsics(K),
        whiteners(pixels, covariances),
    )

    known = np.any(problem.whiteners, axis=(1, 2))
    candidates = [_guess(problem)]
    costs = [problem.cost(*candidates[0])]
    if known.sum() >= 4:
        candidates += _solve(problem, known, cv2.SOLVEPNP_SQPNP)
        costs += [problem.cost(*pose) for pose in candidates[len(costs) :]]
        if min(costs) > _MISFIT * known.sum():
            candidates += _ransac(problem, known)
            costs += [problem.cost(*pose) for pose in candidates[len(costs) :]]
    rotation, translation, cost, information = refine(problem, *candidates[int(np.argmin(costs))])
    # Directions that the keypoints leave open are known to a radian and a metre.
    covariance = np.linalg.inv(information + np.eye(6))
    return PnpResult(make_transform(rotation, translation), covariance, float(cost))


def keypoints_covariance(
    T_cam_obj: np.ndarray, model_points: np.ndarray, pose_covariance: np.ndarray
) -> np.ndarray:
    """Covariance of each keypoint in the camera frame that follows from the pose's.

    Args:
        T_cam_obj: (4, 4).
        model_points: (N, 3), object's frame, metres.
        pose_covariance: (6, 6), as in ``PnpResult``.

    Returns:
        (N, 3, 3), metres squared.
    """
    jacobian = point_jacobian(np.asarray(model_points) @ T_cam_obj[:3, :3].T)
    return jacobian @ pose_covariance @ jacobian.transpose(0, 2, 1)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Model (N, 3), pixels (N, 2), K (3, 3), and W (N, 2, 2) with W^T W = Sigma^-1 or zero."""

    model_points: np.ndarray
    pixels: np.ndarray
    K: np.ndarray
    whiteners: np.ndarray

    def residuals(self, rotated: np.ndarray, translation: np.ndarray) -> np.ndarray:
        """Whitened reprojection errors (N, 2) of the rotated points."""
        points = rotated + translation
        uv = points @ self.K.T
        errors = uv[:, :2] / uv[:, 2:] - self.pixels
        return np.einsum("nij,nj->ni", self.whiteners, errors)

    def cost(self, rotation: np.ndarray, translation: np.ndarray) -> float:
        """Huber cost; infinite unless the object is in front of the camera."""
        rotated = self.model_points @ rotation.T
        if (
            not translation[2] > _NEAREST
            or not (rotated[:, 2] + translation[2]).min() > NEAREST_POINT
        ):
            return np.inf
        return huber_cost(self.residuals(rotated, translation))

    def normal_equations(
        self, rotation: np.ndarray, translation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (6,) and Gauss-Newton matrix (6, 6) of the Huber cost."""
        rotated = self.model_points @ rotation.T
        jacobian = (
            self.whiteners
            @ projection_jacobian(rotated + translation, self.K)
            @ point_jacobian(rotated)
        )
        return robust_normal_equations(self.residuals(rotated, translation), jacobian)


class PnpProblem(Protocol):
    """What :func:`refine` minimises over a pose, given as a rotation and a translation."""

    def cost(self, rotation: np.ndarray, translation: np.ndarray) -> float:
        """Robust cost; infinite where the pose makes no sense."""
        ...

    def normal_equations(
        self, rotation: np.ndarray, translation: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (6,) and Gauss-Newton matrix (6, 6) of the cost in the left perturbation."""
        ...


def refine(
    problem: PnpProblem, rotation: np.ndarray, translation: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Levenberg-Marquardt; returns the pose, its cost and its information (6, 6)."""
    cost = problem.cost(rotation, translation)
    damping = 1e-3
    gradient, information = problem.normal_equations(rotation, translation)
    for _ in range(_ITERATIONS):
        damped = information + np.diag(damping * information.diagonal() + 1e-9)
        step = -np.linalg.solve(damped, gradient)
        turn, _ = cv2.Rodrigues(step[:3])
        new_rotation, new_translation = turn @ rotation, translation + step[3:]
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
    return rotation, translation, cost, information


def robust_normal_equations(
    residuals: np.ndarray, jacobian: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient (6,) and Gauss-Newton matrix (6, 6) of the Huber cost of whitened residuals.

    Args:
        residuals: (N, D).
        jacobian: (N, D, 6).
    """
    distances = np.sqrt((residuals**2).sum(axis=1))
    weights = np.minimum(1.0, _HUBER / np.maximum(distances, 1e-12))
    weighted = (weights[:, None, None] * jacobian).reshape(-1, 6)
    return weighted.T @ residuals.ravel(), weighted.T @ jacobian.reshape(-1, 6)


def projection_jacobian(points: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Derivative (..., 2, 3) of ``geometry.project`` in camera-frame points (..., 3)."""
    uvw = points @ K.T
    depth = uvw[..., 2, None, None]
    return (K[:2] - (uvw[..., :2] / uvw[..., 2:])[..., None] * K[2]) / depth


def point_jacobian(rotated: np.ndarray) -> np.ndarray:
    """Derivative (N, 3, 6) of exp(w) r + t + v in (w, v): [-[r]x, I]."""
    jacobian = np.zeros((len(rotated), 3, 6))
    x, y, z = rotated.T
    jacobian[:, 0, 1], jacobian[:, 0, 2] = z, -y
    jacobian[:, 1, 0], jacobian[:, 1, 2] = -z, x
    jacobian[:, 2, 0], jacobian[:, 2, 1] = y, -x
    jacobian[:, 0, 3] = jacobian[:, 1, 4] = jacobian[:, 2, 5] = 1.0
    return jacobian


def huber_cost(residuals: np.ndarray) -> float:
    """Huber cost of whitened residuals (N, D)."""
    distances = np.sqrt((residuals**2).sum(axis=1))
    far = distances > _HUBER
    return float(np.where(far, _HUBER * (distances - 0.5 * _HUBER), 0.5 * distances**2).sum())


def whiteners(pixels: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """W (N, 2, 2) with W^T W = Sigma^-1, by the closed-form Cholesky factor of a 2x2 inverse."""
    usable = np.isfinite(pixels).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    covariances = np.where(usable[:, None, None], covariances, np.eye(2))
    # A thousandth of a pixel is sharper than any detector.
    a = np.maximum(covariances[:, 0, 0], 1e-6)
    d = np.maximum(covariances[:, 1, 1], 1e-6)
    b = 0.5 * (covariances[:, 0, 1] + covariances[:, 1, 0])
    b = np.clip(b, -0.999 * np.sqrt(a * d), 0.999 * np.sqrt(a * d))
    whiteners = np.zeros_like(covariances)
    # Inverse of the lower Cholesky factor of Sigma.
    first = np.sqrt(a)
    second = np.sqrt(d - b**2 / a)
    whiteners[:, 0, 0] = 1 / first
    whiteners[:, 1, 0] = -b / (a * second)
    whiteners[:, 1, 1] = 1 / second
    whiteners[~usable] = 0.0
    return whiteners


def _guess(problem: _Problem) -> tuple[np.ndarray, np.ndarray]:
    """An upright object on the ray through the keypoints, as far as they are spread."""
    weights = np.maximum((problem.whiteners**2).sum(axis=(1, 2)), 1e-12)
    shares = weights / weights.sum()
    centre = shares @ problem.pixels
    spread = np.sqrt(shares @ ((problem.pixels - centre) ** 2).sum(axis=1))
    centroid = problem.model_points.mean(axis=0)
    radius = np.sqrt(((problem.model_points - centroid) ** 2).sum(axis=1).mean())
    depth = problem.K[0, 0] * radius / max(spread, 1e-9)
    depth = float(np.clip(depth, _NEAREST + 2.5 * np.abs(problem.model_points).max(), 10.0))
    ray = np.linalg.solve(problem.K, np.append(centre, 1.0))
    ray[:2] = np.clip(ray[:2], -10, 10)
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # object's z up in the picture
    return rotation, depth * ray


def _solve(
    problem: _Problem, known: np.ndarray, method: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    try:
        found, rotation, translation = cv2.solvePnP(
            np.ascontiguousarray(problem.model_points[known]),
            np.ascontiguousarray(problem.pixels[known]),
            problem.K,
            None,
            flags=method,
        )
    except cv2.error:
        return []
    return _usable(found, rotation, translation)


def _ransac(problem: _Problem, known: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    # Twice the typical standard deviation of a trusted keypoint.
    deviations = 1 / np.sqrt((problem.whiteners[known] ** 2).sum(axis=(1, 2)) / 2)
    try:
        found, rotation, translation, _ = cv2.solvePnPRansac(
            np.ascontiguousarray(problem.model_points[known]),
            np.ascontiguousarray(problem.pixels[known]),
            problem.K,
            None,
            iterationsCount=50,
            reprojectionError=float(np.clip(2 * np.median(deviations), 1.0, 50.0)),
            flags=cv2.SOLVEPNP_AP3P,
        )
    except cv2.error:
        return []
    return _usable(found, rotation, translation)


def _usable(
    found: bool, rotation: np.ndarray, translation: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    if not found or not np.isfinite(rotation).all() or not np.isfinite(translation).all():
        return []
    return [(cv2.Rodrigues(rotation)[0], translation.ravel())]


def _check_shapes(model_points: np.ndarray, pixels: np.ndarray, covariances: np.ndarray) -> None:
    count = len(model_points)
    if model_points.shape != (count, 3) or count < 4:
        raise ValueError(f"model_points must be (N, 3) with N >= 4, got {model_points.shape}")
    if pixels.shape != (count, 2):
        raise ValueError(f"pixels must be {(count, 2)} to match, got {pixels.shape}")
    if covariances.shape != (count, 2, 2):
        raise ValueError(f"covariances must be {(count, 2, 2)} to match, got {covariances.shape}")
