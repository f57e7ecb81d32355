"""Triangulation against OpenCV, Monte Carlo and views that do not determine a point."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.votes import camera
from two_view_pose.core.geometry import LINEMOD_K, make_transform, project, transform
from two_view_pose.pose_estimator.solvers.triangulation import triangulate

SHIFTED = make_transform(np.eye(3), np.array([-0.2, 0.0, 0.0]))
"""A camera 0.2 m to the right of one at the world's origin."""


def seen(points: np.ndarray, cameras: list[np.ndarray]) -> np.ndarray:
    return np.stack([project(transform(T, points), LINEMOD_K) for T in cameras])


def isotropic(deviation: float, views: int, count: int) -> np.ndarray:
    return np.tile(np.eye(2) * deviation**2, (views, count, 1, 1))


@pytest.mark.parametrize("views", [2, 3])
def test_clean_pixels_give_the_points_in_the_first_camera(views: int):
    rng = np.random.default_rng(0)
    cameras = [camera(25 * v) for v in range(views)]
    points = rng.uniform(-0.1, 0.1, (9, 3))
    result, _ = triangulate(
        seen(points, cameras), isotropic(1.0, views, 9), [LINEMOD_K] * views, cameras
    )
    np.testing.assert_allclose(result, transform(cameras[0], points), atol=1e-7)


def test_near_opencv_with_smaller_reprojection_error():
    rng = np.random.default_rng(1)
    cameras = [camera(0), camera(35)]
    points = rng.uniform(-0.1, 0.1, (40, 3))
    pixels = seen(points, cameras) + rng.normal(size=(2, 40, 2))
    result, _ = triangulate(pixels, isotropic(1.0, 2, 40), [LINEMOD_K] * 2, cameras)
    homogeneous = cv2.triangulatePoints(
        LINEMOD_K @ cameras[0][:3],
        LINEMOD_K @ cameras[1][:3],
        pixels[0].T.copy(),
        pixels[1].T.copy(),
    )
    in_world = (homogeneous[:3] / homogeneous[3]).T
    opencv = transform(cameras[0], in_world)
    assert np.abs(result - opencv).max() < 1e-3

    def squared_errors(points_world: np.ndarray) -> np.ndarray:
        return ((seen(points_world, cameras) - pixels) ** 2).sum(axis=(0, 2))

    ours = squared_errors(transform(np.linalg.inv(cameras[0]), result))
    assert (ours <= squared_errors(in_world) + 1e-9).all()


def test_different_intrinsics():
    rng = np.random.default_rng(2)
    cameras = [camera(0), camera(35)]
    zoomed = np.diag([2.0, 2.0, 1.0]) @ LINEMOD_K
    points = rng.uniform(-0.1, 0.1, (5, 3))
    pixels = np.stack(
        [
            project(transform(T, points), K)
            for T, K in zip(cameras, (LINEMOD_K, zoomed), strict=True)
        ]
    )
    result, _ = triangulate(pixels, isotropic(1.0, 2, 5), [LINEMOD_K, zoomed], cameras)
    np.testing.assert_allclose(result, transform(cameras[0], points), atol=1e-7)


def test_covariance_matches_monte_carlo():
    """2,000 measurements of one point, as 2,000 points of one call."""
    rng = np.random.default_rng(3)
    cameras = [camera(0), camera(30)]
    point = np.array([0.02, -0.03, 0.05])
    covariances = isotropic(0.7, 2, 2000)
    covariances[1, :, 0, 0] *= 16
    noise = (np.linalg.cholesky(covariances) @ rng.normal(size=(2, 2000, 2, 1)))[..., 0]
    pixels = seen(np.tile(point, (2000, 1)), cameras) + noise
    result, claimed = triangulate(pixels, covariances, [LINEMOD_K] * 2, cameras)
    measured = np.cov(result.T)
    np.testing.assert_allclose(
        np.sqrt(np.linalg.eigvalsh(claimed.mean(axis=0))),
        np.sqrt(np.linalg.eigvalsh(measured)),
        rtol=0.1,
    )
    np.testing.assert_allclose(result.mean(axis=0), transform(cameras[0], point), atol=5e-4)


def test_precise_views_have_more_weight():
    rng = np.random.default_rng(4)
    cameras = [camera(v) for v in (0, 40, 80)]
    points = rng.uniform(-0.1, 0.1, (200, 3))
    deviations = np.array([0.5, 0.5, 10.0])
    pixels = seen(points, cameras) + deviations[:, None, None] * rng.normal(size=(3, 200, 2))
    covariances = isotropic(1.0, 3, 200) * deviations[:, None, None, None] ** 2
    truth = transform(cameras[0], points)
    weighted, _ = triangulate(pixels, covariances, [LINEMOD_K] * 3, cameras)
    plain, _ = triangulate(pixels, isotropic(1.0, 3, 200), [LINEMOD_K] * 3, cameras)
    assert (
        np.linalg.norm(weighted - truth, axis=1).mean()
        < 0.3 * np.linalg.norm(plain - truth, axis=1).mean()
    )


@pytest.mark.parametrize("kind", ["parallel", "diverging", "one camera twice", "one view", "none"])
def test_unobservable_depth_is_finite_and_uncertain(kind: str):
    pixels = np.full((2, 3, 2), 300.0)
    cameras = [np.eye(4), np.eye(4) if kind == "one camera twice" else SHIFTED]
    if kind == "diverging":
        pixels[1, :, 0] += 30
    if kind in ("one view", "none"):
        pixels[1] = np.nan
    if kind == "none":
        pixels[0] = np.nan
    points, covariance = triangulate(pixels, isotropic(1.0, 2, 3), [LINEMOD_K] * 2, cameras)
    assert np.isfinite(points).all() and np.isfinite(covariance).all()
    assert (points[:, 2] >= 0.05).all()
    assert np.sqrt(covariance[:, 2, 2]).min() > 0.5
    if kind != "none":  # what is seen is known across the ray
        assert np.linalg.norm(project(points, LINEMOD_K) - 300.0, axis=1).max() < 20


def test_invalid_inputs_raise():
    pixels, covariances = np.zeros((2, 4, 2)), isotropic(1.0, 2, 4)
    cameras, Ks = [np.eye(4), SHIFTED], [LINEMOD_K] * 2
    with pytest.raises(ValueError, match="V >= 2 views"):
        triangulate(pixels[:1], covariances[:1], Ks[:1], cameras[:1])
    with pytest.raises(ValueError, match="covariances"):
        triangulate(pixels, covariances[:, :3], Ks, cameras)
    with pytest.raises(ValueError, match="one entry for each of the 2 views"):
        triangulate(pixels, covariances, Ks, cameras[:1])
    with pytest.raises(ValueError, match=r"Ks\[1\]"):
        triangulate(pixels, covariances, [LINEMOD_K, np.eye(2)], cameras)
    with pytest.raises(ValueError, match=r"T_cam_world\[0\]"):
        triangulate(pixels, covariances, Ks, [2 * np.eye(4), SHIFTED])
