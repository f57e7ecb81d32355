"""Hand-held paths: how far, how smooth, where, and what they look at."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import LINEMOD_K, invert, project, transform
from two_view_pose.envs.simulation.camera import CameraRange
from two_view_pose.envs.simulation.trajectories.hand_held import (
    MIN_HEIGHT,
    hand_held_path,
    slow_drift,
)

CAMERAS = CameraRange(roll=np.deg2rad(12.0), look_at_noise=0.15)
TREMOR = 0.0005


@pytest.fixture(scope="module")
def paths() -> list[tuple[np.ndarray, np.ndarray]]:
    """Center of the scene and T_cam_world (31, 4, 4) of sequences that start anywhere in range."""
    rng = np.random.default_rng(0)
    found = []
    for _ in range(60):
        center = rng.uniform((-0.1, -0.1, -0.03), (0.1, 0.1, 0.12))
        start = invert(CAMERAS.sample(rng, center))[:3, 3]
        found.append((center, hand_held_path(rng, start, center, 31, CAMERAS)))
    return found


def places(path: np.ndarray) -> np.ndarray:
    return np.array([-T[:3, :3].T @ T[:3, 3] for T in path])


@pytest.mark.parametrize(
    ("gap", "low", "high"), [(1, 0.015, 0.03), (5, 0.07, 0.145), (10, 0.14, 0.285)]
)
def test_baselines_are_those_of_the_papers_gaps(paths, gap, low, high) -> None:
    baselines = np.concatenate(
        [np.linalg.norm(places(P)[gap:] - places(P)[:-gap], axis=1) for _, P in paths]
    )
    assert low <= baselines.min() and baselines.max() <= high
    assert baselines.max() > 1.4 * baselines.min()  # the hand is not a machine


def test_paths_are_smooth_but_not_without_tremor(paths) -> None:
    for _, path in paths:
        steps = np.diff(places(path), axis=0)
        way = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        bends = np.rad2deg(np.arccos(np.clip(np.sum(way[1:] * way[:-1], axis=1), -1, 1)))
        assert bends.max() < 18
        turns = Rotation.from_matrix(path[1:, :3, :3] @ path[:-1, :3, :3].transpose(0, 2, 1))
        assert np.rad2deg(turns.magnitude()).max() < 6  # even as it passes right above the scene
        third = np.diff(places(path), 3, axis=0)  # zero for any parabola
        assert 1e-5 < np.linalg.norm(third, axis=1).mean() < 0.0025


def test_cameras_stay_in_range_and_above_the_table(paths) -> None:
    for center, path in paths:
        rays = places(path) - center
        distance = np.linalg.norm(rays, axis=1)
        assert distance.min() >= 0.6 - TREMOR and distance.max() <= 1.4 + TREMOR
        elevation = np.rad2deg(np.arcsin(rays[:, 2] / distance))
        assert elevation.min() > 6.9 and elevation.max() < 82.1
        assert places(path)[:, 2].min() >= MIN_HEIGHT - TREMOR


def test_the_scene_stays_in_the_image(paths) -> None:
    for center, path in paths:
        uv = np.array([project(transform(T, center), LINEMOD_K) for T in path])
        assert (uv > (160, 120)).all() and (uv < (480, 360)).all()
        assert (np.abs(np.diff(uv, axis=0)) < 40).all()
    means = np.array(
        [np.mean([project(transform(T, c), LINEMOD_K) for T in P], 0) for c, P in paths]
    )
    assert means.std(axis=0).min() > 15  # though not always in the middle


def test_the_horizon_is_level_within_the_roll_where_it_can_be_seen(paths) -> None:
    for center, path in paths:
        rays = places(path) - center
        if np.arcsin(rays[:, 2] / np.linalg.norm(rays, axis=1)).max() > np.deg2rad(25):
            continue
        up = path[:, :3, 2]
        assert np.abs(np.rad2deg(np.arctan2(up[:, 0], -up[:, 1]))).max() < 12 + 3


def test_the_middle_frame_stands_where_it_should() -> None:
    center, start = np.array([0.0, 0.1, 0.05]), np.array([0.5, -0.5, 0.4])
    path = hand_held_path(np.random.default_rng(1), start, center, 21, CAMERAS)
    np.testing.assert_allclose(places(path)[10], start, atol=TREMOR)


def test_same_generator_same_path() -> None:
    first, again, other = (
        hand_held_path(np.random.default_rng(s), np.array([0.8, 0, 0.5]), np.zeros(3), 9, CAMERAS)
        for s in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert np.linalg.norm(places(first) - places(other), axis=1).max() > 0.02


@pytest.mark.parametrize("degrees", [7.0, 30.0, 80.0])
def test_a_narrow_range_is_kept_all_the_same(degrees: float) -> None:
    low, high = np.deg2rad((degrees, degrees + 2.5))
    cameras = CameraRange(distance=(0.9, 0.9), elevation=(low, high))
    path = hand_held_path(np.random.default_rng(0), np.array([1, 0, 0.3]), np.zeros(3), 31, cameras)
    distance = np.linalg.norm(places(path), axis=1)
    np.testing.assert_allclose(distance, 0.9, atol=TREMOR)
    elevation = np.arcsin(places(path)[:, 2] / distance)
    slack = TREMOR / 0.9
    assert low - slack <= elevation.min() and elevation.max() <= high + slack


def test_slow_drift_is_slow_and_fills_its_range() -> None:
    drift = slow_drift(np.random.default_rng(0), np.arange(0, 600, 0.5), (50,))
    assert drift.shape == (50, 1200) and np.abs(drift).max() <= 1
    assert drift.max() > 0.9 and drift.min() < -0.9
    power = np.abs(np.fft.rfft(drift * np.hanning(1200), axis=1)) ** 2
    frequency = np.fft.rfftfreq(1200, 0.5)
    assert power[:, frequency > 1 / 10].sum() < 0.01 * power.sum()


def test_one_frame_is_a_path_and_none_is_not() -> None:
    assert hand_held_path(np.random.default_rng(0), np.ones(3), np.zeros(3), 1, CAMERAS).shape == (
        1,
        4,
        4,
    )
    with pytest.raises(ValueError, match="at least one frame, got 0"):
        hand_held_path(np.random.default_rng(0), np.ones(3), np.zeros(3), 0, CAMERAS)
