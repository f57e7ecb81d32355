"""Pose errors against brute force and hand-made cases."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.pose_estimator import metrics
from two_view_pose.pose_estimator.geometry import make_transform, transform


def some_pose(rng: np.random.Generator, spread: float = 0.05) -> np.ndarray:
    translation = rng.normal(size=3) * spread + [0.0, 0.0, 1.0]
    return make_transform(Rotation.random(rng=rng).as_matrix(), translation)


def half_turn() -> np.ndarray:
    return np.diag([-1.0, -1.0, 1.0, 1.0])


def box(symmetric: bool) -> ObjectModel:
    """An object whose points, and keypoints, a half turn about z maps onto themselves."""
    rng = np.random.default_rng(0)
    half = rng.uniform(-0.05, 0.05, (60, 3))
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.05
    empty = np.zeros((0, 3))
    return ObjectModel(
        name="box",
        obj_id=1,
        vertices=corners,
        faces=empty,
        uv=empty,
        texture=empty,
        keypoints=np.vstack([corners, np.zeros((1, 3))]),
        diameter=0.1732,
        symmetries=np.stack([np.eye(4), half_turn()]) if symmetric else np.eye(4)[None],
        points=np.vstack([half, half * [-1, -1, 1]]),
        stable_poses=np.eye(4)[None],
    )


def test_add_of_a_shift_is_its_length():
    rng = np.random.default_rng(1)
    T_true = some_pose(rng)
    shift = make_transform(np.eye(3), np.array([0.003, -0.004, 0.0]))
    assert metrics.add(shift @ T_true, T_true, rng.normal(size=(50, 3))) == pytest.approx(0.005)


def test_add_and_add_s_are_their_definitions():
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.05, 0.05, (80, 3))
    for _ in range(5):
        T_est, T_true = some_pose(rng), some_pose(rng)
        estimated, true = transform(T_est, points), transform(T_true, points)
        pairs = np.linalg.norm(true[:, None] - estimated[None], axis=2)
        assert metrics.add(T_est, T_true, points) == pytest.approx(pairs.diagonal().mean())
        assert metrics.add_s(T_est, T_true, points) == pytest.approx(pairs.min(axis=1).mean())


def test_a_symmetric_object_may_be_turned():
    rng = np.random.default_rng(3)
    T_true = some_pose(rng)
    T_est = T_true @ half_turn()
    assert metrics.add_or_add_s(T_est, T_true, box(symmetric=True)) == pytest.approx(0, abs=1e-9)
    assert metrics.keypoint_distance(T_est, T_true, box(symmetric=True)) < 1e-9
    assert metrics.add_or_add_s(T_est, T_true, box(symmetric=False)) > 0.04
    assert metrics.keypoint_distance(T_est, T_true, box(symmetric=False)) > 0.04


def test_keypoint_distance_takes_the_nearest_equivalent():
    rng = np.random.default_rng(4)
    T_true, model = some_pose(rng), box(symmetric=True)
    shift = make_transform(np.eye(3), np.array([0.0, 0.0, 0.01]))
    T_est = shift @ T_true @ half_turn()
    assert metrics.keypoint_distance(T_est, T_true, model) == pytest.approx(0.01)
    nearest = metrics.nearest_symmetric_pose(T_est, T_true, model)
    np.testing.assert_allclose(nearest, T_true @ half_turn())


def test_rotation_and_translation_error():
    rng = np.random.default_rng(5)
    T_true, model = some_pose(rng), box(symmetric=True)
    turn = make_transform(
        Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix(), np.array([0.0, 0.02, 0])
    )
    T_est = T_true @ half_turn() @ turn
    assert metrics.rotation_error(T_est, T_true, model.symmetries) == pytest.approx(0.3)
    assert metrics.rotation_error(T_est, T_true) == pytest.approx(np.pi, abs=1e-6)
    assert metrics.translation_error(T_est, T_true, model.symmetries) == pytest.approx(0.02)
    off_centre = np.stack([np.eye(4), half_turn()])
    off_centre[1, 0, 3] = 0.1  # the axis does not pass through the origin
    T_est = T_true @ off_centre[1]
    assert metrics.translation_error(T_est, T_true) == pytest.approx(0.1)
    assert metrics.translation_error(T_est, T_true, off_centre) == pytest.approx(0, abs=1e-9)


def test_recall_counts_errors_below_a_share_of_the_diameter():
    errors = np.array([0.009, 0.011, 0.019, 0.021, np.inf])
    assert metrics.recall(errors, 0.1) == pytest.approx(0.2)
    assert metrics.recall(errors, np.array([0.1, 0.1, 0.2, 0.2, 0.2])) == pytest.approx(0.4)
    assert metrics.recall(errors, 0.1, threshold=0.5) == pytest.approx(0.8)


def test_bootstrap_interval_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(6)
    covered = 0
    for _ in range(200):
        low, high = metrics.bootstrap_interval(
            rng.normal(1.0, 2.0, size=60), rng, level=0.9, resamples=400
        )
        covered += low <= 1.0 <= high
    assert 0.82 < covered / 200 < 0.96


def test_bootstrap_interval_is_reproducible():
    values = np.random.default_rng(7).normal(size=30)
    first = metrics.bootstrap_interval(values, np.random.default_rng(8), statistic=np.median)
    again = metrics.bootstrap_interval(values, np.random.default_rng(8), statistic=np.median)
    assert first == again
    assert metrics.bootstrap_interval(np.ones(5), np.random.default_rng(8)) == (1.0, 1.0)


def test_wrong_inputs_are_named():
    good, points = np.eye(4), np.zeros((5, 3))
    with pytest.raises(ValueError, match="T_est"):
        metrics.add(2 * good, good, points)
    with pytest.raises(ValueError, match="points"):
        metrics.add_s(good, good, np.zeros((0, 3)))
    with pytest.raises(ValueError, match="errors"):
        metrics.recall(np.array([np.nan]), 0.1)
    with pytest.raises(ValueError, match="diameters"):
        metrics.recall(np.ones(3), np.ones(2))
    with pytest.raises(ValueError, match="level"):
        metrics.bootstrap_interval(np.ones(3), np.random.default_rng(0), level=95)
