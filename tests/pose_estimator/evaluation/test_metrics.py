"""Pose errors against brute force and hand-made cases."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import make_transform, transform
from two_view_pose.pose_estimator.evaluation import metrics


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


def test_add_s_of_a_symmetric_object_ignores_a_half_turn():
    rng = np.random.default_rng(3)
    T_true = some_pose(rng)
    T_est = T_true @ half_turn()
    assert metrics.add_or_add_s(T_est, T_true, box(symmetric=True)) == pytest.approx(0, abs=1e-9)
    assert metrics.add_or_add_s(T_est, T_true, box(symmetric=False)) > 0.04


def test_keypoints_are_compared_with_the_nearest_equivalent_pose():
    rng = np.random.default_rng(4)
    T_true, model = some_pose(rng), box(symmetric=True)
    off = np.linspace(0, 0.02, 9)
    keypoints = transform(T_true @ half_turn(), model.keypoints)
    keypoints[:, 2] += off
    assert metrics.keypoint_distances(keypoints, T_true, model) == pytest.approx(off, abs=1e-9)
    wrong = metrics.keypoint_distances(keypoints, T_true, box(symmetric=False))
    assert wrong[:8].min() > 0.08  # the corners, which are not on the axis
    T_est = T_true @ half_turn()
    nearest = metrics.nearest_symmetric_pose(T_est, T_true, model)
    np.testing.assert_allclose(nearest, T_true @ half_turn())


def test_wrong_inputs_are_named():
    good, points = np.eye(4), np.zeros((5, 3))
    with pytest.raises(ValueError, match="T_est"):
        metrics.add(2 * good, good, points)
    with pytest.raises(ValueError, match="points"):
        metrics.add_s(good, good, np.zeros((0, 3)))
