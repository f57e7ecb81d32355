"""Linear triangulation against a written-out DLT, and its covariances against Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.votes import camera
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import LINEMOD_K, make_transform, project, transform
from two_view_pose.pose_estimator.solvers.linear_triangulation import triangulate_linearly

# The further cameras have other pixels than the first, as crops have.
KS = [LINEMOD_K, LINEMOD_K @ np.diag([0.5, 0.5, 1.0]), LINEMOD_K @ np.diag([2.0, 2.0, 1.0])]


def rig(angles: tuple[float, ...], count: int = 5) -> tuple[np.ndarray, np.ndarray, list]:
    """World points (N, 3), their pixels (V, N, 2) and T_cam_world of V cameras."""
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (count, 3))
    cameras = [camera(angle) for angle in angles]
    pixels = [project(transform(T, points), K) for T, K in zip(cameras, KS, strict=False)]
    return points, np.stack(pixels), cameras


def spreads(views: int, count: int, seed: int = 1) -> np.ndarray:
    """Covariances of pixels (V, N, 2, 2), no two alike."""
    factors = np.random.default_rng(seed).normal(0, 0.4, (views, count, 2, 2)) + 0.6 * np.eye(2)
    return factors @ factors.swapaxes(-1, -2)


@pytest.mark.parametrize("angles", [(0, 30), (0, -60, 20), (10, 12)])
def test_exact_pixels_give_the_points(angles):
    points, pixels, cameras = rig(angles)
    found, covariance = triangulate_linearly(
        pixels, spreads(len(angles), 5), KS[: len(angles)], cameras
    )
    np.testing.assert_allclose(found, transform(cameras[0], points), atol=1e-7)
    np.testing.assert_allclose(covariance, covariance.swapaxes(-1, -2), atol=1e-15)
    assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_noisy_pixels_match_the_written_out_dlt():
    _, pixels, cameras = rig((0, 25))
    pixels = pixels + np.random.default_rng(2).normal(0, 3, pixels.shape)
    found, _ = triangulate_linearly(pixels, spreads(2, 5), KS[:2], cameras)
    T = cameras[1] @ np.linalg.inv(cameras[0])
    P = [KS[0] @ np.eye(4)[:3], KS[1] @ T[:3]]
    for i in range(5):
        rows = [pixels[v, i, a] * P[v][2] - P[v][a] for v in (0, 1) for a in (0, 1)]
        X = np.linalg.svd(np.array(rows))[2][-1]
        np.testing.assert_allclose(found[i], X[:3] / X[3], atol=1e-9)


@pytest.mark.parametrize("angles", [(0, 20), (0, 60), (0, 25, -40)])
def test_covariance_matches_monte_carlo(angles):
    points, pixels, cameras = rig(angles, count=3)
    views, draws = len(angles), 2000
    given = 0.05 * spreads(views, 3)
    rng = np.random.default_rng(3)
    noise = np.einsum(
        "vnij,dvnj->dvni", np.linalg.cholesky(given), rng.normal(size=(draws, views, 3, 2))
    )
    # All samples at once, as points of one call.
    many = (pixels + noise).transpose(1, 0, 2, 3).reshape(views, -1, 2)
    repeated = np.tile(given[:, None], (1, draws, 1, 1, 1)).reshape(views, -1, 2, 2)
    found, covariance = triangulate_linearly(many, repeated, KS[:views], cameras)
    errors = (found - np.tile(transform(cameras[0], points), (draws, 1))).reshape(draws, 3, 3)
    for i in range(3):
        claimed = covariance.reshape(draws, 3, 3, 3)[:, i].mean(0)
        scale = np.sqrt(np.outer(np.diag(claimed), np.diag(claimed)))
        assert np.abs((np.cov(errors[:, i].T) - claimed) / scale).max() < 0.12
        assert np.linalg.norm(errors[:, i].mean(0)) < 0.2 * np.sqrt(np.trace(claimed))


def test_third_view_reduces_covariance_less_than_independent_pairs():
    _, pixels, cameras = rig((0, 25, -25))
    covariances = np.tile(np.eye(2), (3, 5, 1, 1))
    _, three = triangulate_linearly(pixels, covariances, KS, cameras)
    pairs = [
        triangulate_linearly(pixels[p], covariances[p], [KS[i] for i in p], [cameras[i] for i in p])
        for p in ([0, 1], [0, 2])
    ]
    independent = np.linalg.inv(sum(np.linalg.inv(c) for _, c in pairs))
    for i in range(5):
        assert np.trace(three[i]) < min(np.trace(c[i]) for _, c in pairs)
        assert np.trace(three[i]) > np.trace(independent[i])


def check_finite(found: np.ndarray, covariance: np.ndarray, cameras: list) -> None:
    assert np.isfinite(found).all() and np.isfinite(covariance).all()
    assert np.linalg.eigvalsh(covariance).min() > 0
    for T in cameras:
        assert transform(T @ np.linalg.inv(cameras[0]), found)[:, 2].min() > 0


def test_parallel_rays_are_finite_and_uncertain():
    pixels = np.tile([[300.0, 200.0], [340.0, 260.0]], (2, 1, 1))
    aside = make_transform(np.eye(3), np.array([-0.1, 0, 0]))
    for cameras in ([np.eye(4), np.eye(4)], [np.eye(4), aside]):
        found, covariance = triangulate_linearly(
            pixels, np.tile(np.eye(2), (2, 2, 1, 1)), [LINEMOD_K] * 2, cameras
        )
        check_finite(found, covariance, cameras)
        assert np.sqrt(np.linalg.eigvalsh(covariance)[:, -1]).min() > 0.5


def test_nearly_parallel_rays_have_the_theoretical_depth_error():
    baseline, depth, sigma = 0.005, 0.9, 0.3
    aside = make_transform(np.eye(3), np.array([-baseline, 0, 0]))
    point = np.array([[0.0, 0.0, depth]])
    pixels = np.stack([project(transform(T, point), LINEMOD_K) for T in (np.eye(4), aside)])
    covariances = np.tile(sigma**2 * np.eye(2), (2, 1, 1, 1))
    _, covariance = triangulate_linearly(pixels, covariances, [LINEMOD_K] * 2, [np.eye(4), aside])
    # Depth from disparity: dz = z^2 / (f b) d(disparity).
    expected = depth**2 / (LINEMOD_K[0, 0] * baseline) * np.sqrt(2) * sigma
    assert np.sqrt(covariance[0, 2, 2]) == pytest.approx(expected, rel=1e-3)


def test_diverging_rays_give_points_in_front():
    aside = make_transform(np.eye(3), np.array([-0.2, 0, 0]))
    pixels = np.array([[[300.0, 240.0]], [[400.0, 240.0]]])  # they diverge
    found, covariance = triangulate_linearly(
        pixels, np.tile(np.eye(2), (2, 1, 1, 1)), [LINEMOD_K] * 2, [np.eye(4), aside]
    )
    check_finite(found, covariance, [np.eye(4), aside])


@pytest.mark.parametrize("views", [2, 3])
def test_random_inputs_give_finite_points(views):
    rng = np.random.default_rng(4)
    for _ in range(20):
        cameras = [
            make_transform(Rotation.random(rng=rng).as_matrix(), rng.normal(0, 1, 3))
            for _ in range(views)
        ]
        pixels = rng.normal(300, 10.0 ** rng.uniform(0, 6), (views, 9, 2))
        covariances = np.eye(2) * 10.0 ** rng.uniform(-6, 6, (views, 9, 1, 1))
        found, covariance = triangulate_linearly(pixels, covariances, [LINEMOD_K] * views, cameras)
        assert np.isfinite(found).all() and np.isfinite(covariance).all()


def test_point_missing_in_one_view():
    points, pixels, cameras = rig((0, 25, -40))
    pixels[1, 2] = np.nan
    covariances = np.tile(np.eye(2), (3, 5, 1, 1))
    found, covariance = triangulate_linearly(pixels, covariances, KS, cameras)
    np.testing.assert_allclose(found, transform(cameras[0], points), atol=1e-3)
    assert np.isfinite(covariance).all()


def test_invalid_inputs_raise():
    _, pixels, cameras = rig((0, 25))
    covariances = spreads(2, 5)
    with pytest.raises(ValueError, match="V >= 2 views"):
        triangulate_linearly(pixels[:1], covariances[:1], KS[:1], cameras[:1])
    with pytest.raises(ValueError, match="covariances must be"):
        triangulate_linearly(pixels, covariances[:, :4], KS[:2], cameras)
    with pytest.raises(ValueError, match="one entry for each of the 2 views"):
        triangulate_linearly(pixels, covariances, KS[:1], cameras)
