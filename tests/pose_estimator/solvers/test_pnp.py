"""Uncertainty-driven PnP against OpenCV, finite differences and Monte Carlo."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import LINEMOD_K, check_rigid, make_transform, project, transform
from two_view_pose.pose_estimator.solvers.pnp import keypoints_covariance, uncertainty_pnp
from two_view_pose.pose_estimator.solvers.reprojection import projection_jacobian

MODEL = np.vstack([np.random.default_rng(0).uniform(-0.07, 0.07, (8, 3)), np.zeros((1, 3))])


def some_pose(rng: np.random.Generator) -> np.ndarray:
    translation = [*rng.uniform(-0.15, 0.15, 2), rng.uniform(0.6, 1.3)]
    return make_transform(Rotation.random(rng=rng).as_matrix(), np.array(translation))


def isotropic(deviation: float, count: int = 9) -> np.ndarray:
    return np.tile(np.eye(2) * deviation**2, (count, 1, 1))


def keypoint_error(T_est: np.ndarray, T_true: np.ndarray) -> float:
    return float(np.linalg.norm(transform(T_est, MODEL) - transform(T_true, MODEL), axis=1).mean())


def left_difference(T_est: np.ndarray, T_true: np.ndarray) -> np.ndarray:
    """The perturbation (w, v) that takes the true pose to the estimate, (6,)."""
    rotation = Rotation.from_matrix(T_est[:3, :3] @ T_true[:3, :3].T).as_rotvec()
    return np.concatenate([rotation, T_est[:3, 3] - T_true[:3, 3]])


def test_clean_pixels_give_the_pose():
    rng = np.random.default_rng(1)
    for _ in range(20):
        T = some_pose(rng)
        pixels = project(transform(T, MODEL), LINEMOD_K)
        result = uncertainty_pnp(MODEL, pixels, isotropic(1.0), LINEMOD_K)
        np.testing.assert_allclose(result.T_cam_obj, T, atol=1e-6)
        assert result.cost < 1e-9


def test_equal_covariances_match_opencv_refine_lm():
    """Within the Huber limit, the optimum is that of OpenCV's own Levenberg-Marquardt."""
    rng = np.random.default_rng(2)
    for _ in range(10):
        T = some_pose(rng)
        pixels = project(transform(T, MODEL), LINEMOD_K) + rng.normal(size=(9, 2)) * 0.5
        rvec, shift = cv2.solvePnPRefineLM(
            MODEL, pixels, LINEMOD_K, None, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3:].copy()
        )
        expected = make_transform(cv2.Rodrigues(rvec)[0], shift.ravel())
        result = uncertainty_pnp(MODEL, pixels, isotropic(5.0), LINEMOD_K)
        assert keypoint_error(result.T_cam_obj, expected) < 2e-4


def test_uncertain_keypoints_have_less_weight():
    """Half of the keypoints are off by 20 pixels along a direction of large variance."""
    rng = np.random.default_rng(3)
    weighted, plain = [], []
    for _ in range(20):
        T = some_pose(rng)
        pixels = project(transform(T, MODEL), LINEMOD_K) + rng.normal(size=(9, 2)) * 0.3
        covariances = isotropic(0.3)
        for k in range(4):
            axis = np.array([np.cos(k), np.sin(k)])
            pixels[k] += 20 * rng.normal() * axis
            covariances[k] += 400 * np.outer(axis, axis)
        weighted.append(
            keypoint_error(uncertainty_pnp(MODEL, pixels, covariances, LINEMOD_K).T_cam_obj, T)
        )
        plain.append(
            keypoint_error(uncertainty_pnp(MODEL, pixels, isotropic(0.3), LINEMOD_K).T_cam_obj, T)
        )
    assert np.median(weighted) < 0.01
    assert np.median(weighted) < 0.7 * np.median(plain)


def test_robust_to_gross_outliers():
    rng = np.random.default_rng(4)
    robust, plain = [], []
    for _ in range(20):
        T = some_pose(rng)
        pixels = project(transform(T, MODEL), LINEMOD_K) + rng.normal(size=(9, 2)) * 0.3
        pixels[:2] += rng.normal(size=(2, 2)) * 80
        result = uncertainty_pnp(MODEL, pixels, isotropic(0.5), LINEMOD_K)
        robust.append(keypoint_error(result.T_cam_obj, T))
        _, rvec, shift = cv2.solvePnP(MODEL, pixels, LINEMOD_K, None, flags=cv2.SOLVEPNP_SQPNP)
        plain.append(keypoint_error(make_transform(cv2.Rodrigues(rvec)[0], shift.ravel()), T))
    assert np.median(robust) < 0.01 < np.median(plain)


@pytest.mark.slow
def test_covariance_matches_monte_carlo():
    rng = np.random.default_rng(5)
    T = some_pose(rng)
    clean = project(transform(T, MODEL), LINEMOD_K)
    covariances = isotropic(0.3)
    covariances[:3, 0, 0] *= 9
    factors = np.linalg.cholesky(covariances)
    differences, claimed = [], []
    for _ in range(300):
        pixels = clean + (factors @ rng.normal(size=(9, 2, 1)))[..., 0]
        result = uncertainty_pnp(MODEL, pixels, covariances, LINEMOD_K)
        differences.append(left_difference(result.T_cam_obj, T))
        claimed.append(result.covariance)
    measured = np.cov(np.array(differences).T)
    claimed = np.mean(claimed, axis=0)
    ratio = np.sqrt(np.diag(claimed) / np.diag(measured))
    assert ((ratio > 0.75) & (ratio < 1.33)).all(), ratio
    # The same for the propagated covariance of the 3D keypoints.
    rotations = Rotation.from_rotvec(np.array(differences)[:, :3]).as_matrix() @ T[:3, :3]
    shifts = T[:3, 3] + np.array(differences)[:, 3:]
    spread = MODEL @ rotations.transpose(0, 2, 1) + shifts[:, None]
    propagated = keypoints_covariance(T, MODEL, claimed)
    for k in range(9):
        ratio = np.sqrt(np.diag(propagated[k]) / spread[:, k].var(axis=0))
        assert ((ratio > 0.7) & (ratio < 1.4)).all(), ratio


def test_projection_jacobian_matches_finite_differences():
    point = np.array([0.1, -0.2, 0.9])
    numeric = approx_fprime(point, lambda p: project(p, LINEMOD_K), 1e-7)
    np.testing.assert_allclose(projection_jacobian(point, LINEMOD_K), numeric, atol=1e-2)


def test_random_inputs_give_a_finite_pose_in_front():
    rng = np.random.default_rng(6)
    for case in range(60):
        pixels = rng.normal(size=(9, 2)) * 10 ** rng.uniform(-3, 5)
        covariances = isotropic(10 ** rng.uniform(-3, 3))
        if case % 5 == 0:
            pixels[: rng.integers(10)] = np.nan
        if case % 7 == 0:
            pixels[:] = pixels[0]
        if case % 11 == 0:
            covariances[:] = 0
        if case % 13 == 0:
            covariances[:4] = np.inf
        result = uncertainty_pnp(MODEL, pixels, covariances, LINEMOD_K)
        check_rigid(result.T_cam_obj)
        assert result.T_cam_obj[2, 3] > 0.05
        assert np.isfinite(result.cost) and np.isfinite(result.covariance).all()
        assert (np.linalg.eigvalsh(result.covariance) > 0).all()


def test_unconstrained_pose_has_the_prior_covariance():
    result = uncertainty_pnp(MODEL, np.full((9, 2), np.nan), isotropic(1.0), LINEMOD_K)
    np.testing.assert_allclose(result.covariance, np.eye(6))


def test_invalid_inputs_raise():
    pixels, covariances = np.zeros((9, 2)), isotropic(1.0)
    with pytest.raises(ValueError, match="model_points"):
        uncertainty_pnp(MODEL[:3], pixels[:3], covariances[:3], LINEMOD_K)
    with pytest.raises(ValueError, match="pixels"):
        uncertainty_pnp(MODEL, pixels[:8], covariances, LINEMOD_K)
    with pytest.raises(ValueError, match="covariances"):
        uncertainty_pnp(MODEL, pixels, np.ones((9, 2)), LINEMOD_K)
    with pytest.raises(ValueError, match="K"):
        uncertainty_pnp(MODEL, pixels, covariances, np.zeros((3, 3)))
