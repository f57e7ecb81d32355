"""Multi-view PnP: exact, more accurate than one view or triangulation, calibrated covariance."""

import numpy as np
import pytest
from helpers.votes import T_WORLD_OBJ, camera
from two_view_pose.core.geometry import LINEMOD_K, make_transform, project, transform
from two_view_pose.pose_estimator.solvers.multi_view_pnp import multi_view_pnp
from two_view_pose.pose_estimator.solvers.pnp import uncertainty_pnp
from two_view_pose.pose_estimator.solvers.triangulation import triangulate

MODEL = np.array(
    [[x, y, z] for x in (-0.05, 0.05) for y in (-0.04, 0.04) for z in (-0.03, 0.03)] + [[0, 0, 0]]
)
T_TRUE = camera(20) @ T_WORLD_OBJ


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def problem(degrees: float, noise: float, rng: np.random.Generator) -> dict:
    cameras = [camera(20), camera(20 + degrees)]
    pixels = np.stack([project(transform(T @ T_WORLD_OBJ, MODEL), LINEMOD_K) for T in cameras])
    return {
        "pixels": pixels + rng.normal(0, noise, pixels.shape) if noise else pixels,
        "covariances": np.broadcast_to(max(noise, 0.5) ** 2 * np.eye(2), (2, 9, 2, 2)),
        "Ks": [LINEMOD_K, LINEMOD_K],
        "T_cam_world": cameras,
    }


@pytest.mark.parametrize("degrees", [1.0, 40.0])
def test_perfect_pixels_give_the_pose(degrees, rng):
    start = T_TRUE @ make_transform(np.eye(3), [0.02, -0.03, 0.04])
    lost = make_transform(np.eye(3), [0, 0, -1.0])
    found = multi_view_pnp(MODEL, **problem(degrees, 0, rng), starts=[lost, start])
    np.testing.assert_allclose(found.T_cam_obj, T_TRUE, atol=1e-6)
    assert found.cost < 1e-9


def test_more_accurate_than_one_view_and_triangulation_with_calibrated_covariance(rng):
    errors: dict[str, list[float]] = {"both": [], "one": [], "points": []}
    distances = []
    for _ in range(40):
        given = problem(3.0, 2.0, rng)
        one = uncertainty_pnp(MODEL, given["pixels"][0], given["covariances"][0], LINEMOD_K)
        points, _ = triangulate(**given)
        both = multi_view_pnp(MODEL, **given, starts=[one.T_cam_obj])
        errors["one"].append(np.linalg.norm(one.T_cam_obj[:3, 3] - T_TRUE[:3, 3]))
        errors["points"].append(np.linalg.norm(points.mean(0) - transform(T_TRUE, MODEL).mean(0)))
        shift = both.T_cam_obj[:3, 3] - T_TRUE[:3, 3]
        errors["both"].append(np.linalg.norm(shift))
        distances.append(shift @ np.linalg.solve(both.covariance[3:, 3:], shift))
    median = {name: np.median(values) for name, values in errors.items()}
    assert median["both"] < 0.9 * median["one"] and median["both"] < 0.5 * median["points"]
    assert 1.0 < np.median(distances) < 6.0  # chi-squared of three: 2.4


def test_start_behind_the_cameras_is_returned(rng):
    lost = make_transform(np.eye(3), [0, 0, -1.0])
    found = multi_view_pnp(MODEL, **problem(30.0, 0, rng), starts=[lost])
    assert np.array_equal(found.T_cam_obj, lost) and found.cost == np.inf


def test_invalid_shapes_raise(rng):
    given = problem(30.0, 0, rng)
    with pytest.raises(ValueError, match="one entry for each of the 2 views"):
        multi_view_pnp(MODEL, **given | {"Ks": [LINEMOD_K]}, starts=[T_TRUE])
    with pytest.raises(ValueError, match="needs pixels of 9 keypoints and a start"):
        multi_view_pnp(MODEL, **given, starts=[])
