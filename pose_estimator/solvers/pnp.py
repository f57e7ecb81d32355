"""Pose from 2D keypoints and their covariances in one view: uncertainty-driven PnP.

PVNet (Peng et al., CVPR 2019, section 3.2) minimizes the Mahalanobis distance between the projected
model keypoints and the voted ones,

    sum_k (p_k - q_k)^T Sigma_k^-1 (p_k - q_k),

here with a Huber weight (:mod:`reprojection`), from the better of OpenCV's global solvers.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...core.errors import InputError
from ...core.geometry import check_intrinsics
from .reprojection import PnpResult, ReprojectionProblem, point_jacobian, refine, whiteners

_MIN_DEPTH = 0.05
"""Depth in meters of the object's origin that a pose has at least."""

_MAX_MEAN_COST = 2.0
"""Mean Huber cost of a keypoint from which the first solver's answer is distrusted."""


def uncertainty_pnp(
    model_points: np.ndarray, pixels: np.ndarray, covariances: np.ndarray, K: np.ndarray
) -> PnpResult:
    """The pose that best explains the keypoints, each as far as it can be trusted.

    Always answers with a finite pose in front of the camera, also for pixels that no pose explains.
    A keypoint whose pixel or covariance is not finite is left out.

    Args:
        model_points: (N, 3) in the object's frame, meters, N >= 4.
        pixels: (N, 2).
        covariances: of the pixels, (N, 2, 2), pixels squared.
        K: camera matrix, (3, 3).

    Raises:
        InputError: if shapes do not match, there are fewer than 4 points, or ``K`` is no camera
            matrix.
    """
    model_points = np.asarray(model_points, dtype=np.float64)
    pixels = np.asarray(pixels, dtype=np.float64)
    covariances = np.asarray(covariances, dtype=np.float64)
    _check_shapes(model_points, pixels, covariances)
    problem = _SingleView(
        pixels=np.nan_to_num(pixels, posinf=0, neginf=0)[None],
        whiteners=whiteners(pixels, covariances)[None],
        Ks=check_intrinsics(K)[None],
        T_view_first=np.eye(4)[None],
        model_points=model_points,
    )
    known = problem.sees[0]
    candidates = [_guess(problem)]
    costs = [problem.cost(*candidates[0])]
    if known.sum() >= 4:
        candidates += _solve(problem, known, cv2.SOLVEPNP_SQPNP)
        costs += [problem.cost(*pose) for pose in candidates[len(costs) :]]
        if min(costs) > _MAX_MEAN_COST * known.sum():
            candidates += _ransac(problem, known)
            costs += [problem.cost(*pose) for pose in candidates[len(costs) :]]
    return refine(problem, *candidates[int(np.argmin(costs))])


def keypoints_covariance(
    T_cam_obj: np.ndarray, model_points: np.ndarray, pose_covariance: np.ndarray
) -> np.ndarray:
    """Covariance of each keypoint in the camera frame that follows from the pose's.

    Args:
        T_cam_obj: (4, 4).
        model_points: (N, 3), object's frame, meters.
        pose_covariance: (6, 6), as in ``PnpResult``.

    Returns:
        (N, 3, 3), meters squared.
    """
    jacobian = point_jacobian(np.asarray(model_points) @ T_cam_obj[:3, :3].T)
    return jacobian @ pose_covariance @ jacobian.transpose(0, 2, 1)


@dataclass(frozen=True, eq=False)
class _SingleView(ReprojectionProblem):
    """The problem of one view, which has the object's origin in front of it as well."""

    def cost(self, rotation: np.ndarray, translation: np.ndarray) -> float:
        return super().cost(rotation, translation) if translation[2] > _MIN_DEPTH else np.inf

    def whiten(self, errors: np.ndarray) -> np.ndarray:
        # Rounds differently from a matrix product; measured answers depend on it.
        return np.einsum("vnij,vnj->vni", self.whiteners, errors)


def _guess(problem: _SingleView) -> tuple[np.ndarray, np.ndarray]:
    """An upright object on the ray through the keypoints, as far as they are spread."""
    pixels, K = problem.pixels[0], problem.Ks[0]
    weights = np.maximum((problem.whiteners[0] ** 2).sum(axis=(1, 2)), 1e-12)
    shares = weights / weights.sum()
    center = shares @ pixels
    spread = np.sqrt(shares @ ((pixels - center) ** 2).sum(axis=1))
    centroid = problem.model_points.mean(axis=0)
    radius = np.sqrt(((problem.model_points - centroid) ** 2).sum(axis=1).mean())
    depth = K[0, 0] * radius / max(spread, 1e-9)
    depth = float(np.clip(depth, _MIN_DEPTH + 2.5 * np.abs(problem.model_points).max(), 10.0))
    ray = np.linalg.solve(K, np.append(center, 1.0))
    ray[:2] = np.clip(ray[:2], -10, 10)
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # object's z up in the image
    return rotation, depth * ray


def _solve(
    problem: _SingleView, known: np.ndarray, method: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    try:
        found, rotation, translation = cv2.solvePnP(
            np.ascontiguousarray(problem.model_points[known]),
            np.ascontiguousarray(problem.pixels[0, known]),
            problem.Ks[0],
            None,
            flags=method,
        )
    except cv2.error:
        return []
    return _candidates(found, rotation, translation)


def _ransac(problem: _SingleView, known: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    # Twice the typical standard deviation of a trusted keypoint.
    deviations = 1 / np.sqrt((problem.whiteners[0, known] ** 2).sum(axis=(1, 2)) / 2)
    try:
        found, rotation, translation, _ = cv2.solvePnPRansac(
            np.ascontiguousarray(problem.model_points[known]),
            np.ascontiguousarray(problem.pixels[0, known]),
            problem.Ks[0],
            None,
            iterationsCount=50,
            reprojectionError=float(np.clip(2 * np.median(deviations), 1.0, 50.0)),
            flags=cv2.SOLVEPNP_AP3P,
        )
    except cv2.error:
        return []
    return _candidates(found, rotation, translation)


def _candidates(
    found: bool, rotation: np.ndarray, translation: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    if not found or not np.isfinite(rotation).all() or not np.isfinite(translation).all():
        return []
    return [(cv2.Rodrigues(rotation)[0], translation.ravel())]


def _check_shapes(model_points: np.ndarray, pixels: np.ndarray, covariances: np.ndarray) -> None:
    count = len(model_points)
    if model_points.shape != (count, 3) or count < 4:
        raise InputError(f"model_points must be (N, 3) with N >= 4, got {model_points.shape}")
    if pixels.shape != (count, 2):
        raise InputError(f"pixels must be {(count, 2)} to match, got {pixels.shape}")
    if covariances.shape != (count, 2, 2):
        raise InputError(f"covariances must be {(count, 2, 2)} to match, got {covariances.shape}")
