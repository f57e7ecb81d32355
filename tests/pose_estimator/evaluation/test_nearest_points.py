"""The index of ADD-S against an exhaustive search in double precision."""

import numpy as np
import pytest
from benchmarks.groups.metrics import add_s_of_bop, pose_pairs
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import make_transform, transform
from two_view_pose.pose_estimator.evaluation import metrics
from two_view_pose.pose_estimator.evaluation.nearest_points import NearestPoints


def exhaustive(points, T):
    moved = transform(T, points)
    return np.mean([np.linalg.norm(points - point, axis=1).min() for point in moved])


def shell(rng, count=400, radius=0.08):
    points = rng.normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True) + (0.02, -0.01, 0.3)


def test_equal_to_bop_toolkit():
    rng = np.random.default_rng(0)
    points = shell(rng, 2000)
    index = NearestPoints(points)
    for T_est, T_true in pose_pairs(rng, 0.16, 30):
        value = metrics.add_s(T_est, T_true, points, tree=index)
        assert value == pytest.approx(add_s_of_bop(T_est, T_true, points), abs=5e-12)
        assert value == pytest.approx(metrics.add_s(T_est, T_true, points), abs=1e-15)


@pytest.mark.parametrize("distance", [0.0, 1e-9, 0.01, 0.3, 0.4, 20.0, 1e6, 1e30])
def test_near_and_far(distance):
    rng = np.random.default_rng(1)
    points = shell(rng)
    T = make_transform(Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix(), np.zeros(3))
    center = points.mean(axis=0)
    T[:3, 3] = center - T[:3, :3] @ center + (0.0, 0.6 * distance, 0.8 * distance)
    found = NearestPoints(points).mean_distance(T)
    assert found == pytest.approx(exhaustive(points, T), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    "points",
    [
        np.ones((1, 3)),
        np.ones((500, 3)),
        np.outer(np.linspace(0, 0.1, 300), (1.0, 0.0, 0.0)),
        0.01 * np.stack(np.meshgrid(*[np.arange(7.0)] * 3), -1).reshape(-1, 3),
    ],
    ids=["one", "all the same", "on a line", "on a grid"],
)
def test_degenerate_points(points):
    T = make_transform(Rotation.from_rotvec([0.0, 0.4, 0.1]).as_matrix(), np.full(3, 0.005))
    found = NearestPoints(points).mean_distance(T)
    assert found == pytest.approx(exhaustive(points, T), abs=1e-9)


def test_points_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="finite"):
        NearestPoints(np.array([[0.0, np.nan, 0.0]]))
