"""Uncertainty-driven PnP: the pose from 2D keypoints with covariances in one view.

PVNet (Peng et al., CVPR 2019, section 3.2) minimizes the Mahalanobis distance between the projected
model keypoints and the voted ones,

    sum_k (p_k - q_k)^T Sigma_k^-1 (p_k - q_k),

here with a Huber weight (:mod:`reprojection`), starting from OpenCV's global solvers.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from ...core.errors import InputError
from ...core.geometry import check_intrinsics
from .reprojection import PnpResult, ReprojectionProblem, point_jacobian, refine, whiteners

_MIN_DEPTH = 0.05
"""Smallest depth in meters of the object's origin."""

_MAX_MEAN_COST = 2.0
"""Mean Huber cost of a keypoint above which RANSAC is tried too."""


def uncertainty_pnp(
    model_points: np.ndarray, pixels: np.ndarray, covariances: np.ndarray, K: np.ndarray
) -> PnpResult:
    """Finds the pose of least Huber cost of the Mahalanobis reprojection errors.

    Always returns a finite pose in front of the camera. Keypoints whose pixel or covariance is not
    finite are ignored.

    Args:
        model_points: (N, 3) in the object's frame, meters, N >= 4.
        pixels: (N, 2).
        covariances: of the pixels, (N, 2, 2), pixels squared.
        K: camera matrix, (3, 3).

    Raises:
        InputError: if shapes do not match, there are fewer than 4 points, or ``K`` is invalid.
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
        candidates += _solve(problem, known, ransac=False)
        costs += [problem.cost(*pose) for pose in candidates[len(costs) :]]
        if min(costs) > _MAX_MEAN_COST * known.sum():
            candidates += _solve(problem, known, ransac=True)
            costs += [problem.cost(*pose) for pose in candidates[len(costs) :]]
    return refine(problem, *candidates[int(np.argmin(costs))])


def keypoints_covariance(
    T_cam_obj: np.ndarray, model_points: np.ndarray, pose_covariance: np.ndarray
) -> np.ndarray:
    """Propagates a pose covariance (6, 6), see ``PnpResult``, to the keypoints.

    Returns covariances (N, 3, 3) in the camera frame, meters squared, of ``model_points`` (N, 3).
    """
    jacobian = point_jacobian(np.asarray(model_points) @ T_cam_obj[:3, :3].T)
    return jacobian @ pose_covariance @ jacobian.transpose(0, 2, 1)


@dataclass(frozen=True, eq=False)
class _SingleView(ReprojectionProblem):
    """One view, with the object's origin in front of the camera as well."""

    def cost(self, rotation: np.ndarray, translation: np.ndarray) -> float:
        return super().cost(rotation, translation) if translation[2] > _MIN_DEPTH else np.inf

    def whiten(self, errors: np.ndarray) -> np.ndarray:
        # Rounds differently from a matrix product; measured results depend on it.
        return np.einsum("vnij,vnj->vni", self.whiteners, errors)


def _guess(problem: _SingleView) -> tuple[np.ndarray, np.ndarray]:
    """Initial pose: upright, on the ray through the keypoints, at the depth of their spread."""
    pixels, K = problem.pixels[0], problem.Ks[0]
    weights = np.maximum((problem.whiteners[0] ** 2).sum(axis=(1, 2)), 1e-12)
    weights = weights / weights.sum()
    center = weights @ pixels
    spread = np.sqrt(weights @ ((pixels - center) ** 2).sum(axis=1))
    centroid = problem.model_points.mean(axis=0)
    radius = np.sqrt(((problem.model_points - centroid) ** 2).sum(axis=1).mean())
    depth = K[0, 0] * radius / max(spread, 1e-9)
    depth = float(np.clip(depth, _MIN_DEPTH + 2.5 * np.abs(problem.model_points).max(), 10.0))
    ray = np.linalg.solve(K, np.append(center, 1.0))
    ray[:2] = np.clip(ray[:2], -10, 10)
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # object's z up in the image
    return rotation, depth * ray


def _solve(
    problem: _SingleView, known: np.ndarray, ransac: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    """OpenCV's SQPNP or RANSAC on the usable keypoints; an empty list if it fails."""
    points = np.ascontiguousarray(problem.model_points[known])
    given = points, np.ascontiguousarray(problem.pixels[0, known]), problem.Ks[0], None
    # Twice the typical standard deviation of a usable keypoint.
    deviations = 1 / np.sqrt((problem.whiteners[0, known] ** 2).sum(axis=(1, 2)) / 2)
    limit = float(np.clip(2 * np.median(deviations), 1.0, 50.0))
    try:
        if ransac:
            found, rotation, translation, _ = cv2.solvePnPRansac(
                *given, iterationsCount=50, reprojectionError=limit, flags=cv2.SOLVEPNP_AP3P
            )
        else:
            found, rotation, translation = cv2.solvePnP(*given, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        return []
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
