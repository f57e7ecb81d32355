"""Signed distances against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.assets.build import solids


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.random.default_rng(0).uniform(-3, 3, (2000, 3))


def test_box_distance_is_the_distance_to_the_nearest_point_of_the_box(points: np.ndarray) -> None:
    center, size = np.array([0.3, -0.2, 0.5]), np.array([2.0, 1.0, 1.5])
    distance = solids.box(center, size)(points)
    nearest = np.clip(points, center - size / 2, center + size / 2)
    outside = (nearest != points).any(axis=1)
    expected = np.linalg.norm(points - nearest, axis=1)
    np.testing.assert_allclose(distance[outside], expected[outside], atol=1e-12)
    to_wall = (size / 2 - np.abs(points - center)).min(axis=1)
    np.testing.assert_allclose(distance[~outside], -to_wall[~outside], atol=1e-12)
    assert 0 < outside.sum() < len(points)


@pytest.mark.parametrize(
    ("sdf", "surface"),
    [
        (solids.sphere((1, 2, 3), 0.5), [(1.5, 2, 3), (1, 2, 2.5)]),
        (solids.ellipsoid((0, 0, 1), (1, 2, 3)), [(1, 0, 1), (0, -2, 1), (0, 0, 4)]),
        (solids.box((0, 0, 0), (2, 2, 2), 0.2), [(1, 0, 0), (0.8 + 0.2 / np.sqrt(2),) * 2 + (0,)]),
        (solids.capsule((0, 0, 0), (0, 0, 2), 0.5), [(0.5, 0, 1), (0, 0, 2.5), (0, 0.5, 0)]),
        (solids.capsule((0, 0, 0), (0, 0, 2), 0.5, 0.1), [(0.3, 0, 1), (0, 0, -0.5), (0, 0, 2.1)]),
        (solids.cylinder((0, 0, 0), (2, 0, 0), 0.5), [(1, 0.5, 0), (0, 0.2, 0), (2, 0.5, 0)]),
        (solids.cylinder((0, 0, 0), (0, 2, 0), 1.0, 0.4), [(0.7, 1, 0), (1, 0, 0), (0, 2, 0.4)]),
        (solids.torus((0, 0, 0), (0, 0, 2), 2, 0.5), [(2.5, 0, 0), (0, 2, 0.5), (-1.5, 0, 0)]),
        (solids.half_space((0, 0, 1), (0, 0, 5)), [(7, 8, 1)]),
        (
            solids.prism([(0, 0), (2, 0), (0, 1)], axis=1, low=-1, high=3),
            [(1, 0, 0), (1, 2, 0.5), (0.2, 3, 0.2), (0, -1, 1)],
        ),
    ],
)
def test_surface_points_have_distance_zero(
    sdf: solids.Sdf, surface: list[tuple[float, float, float]]
) -> None:
    np.testing.assert_allclose(sdf(np.array(surface, dtype=float)), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    "sdf",
    [
        solids.sphere((0.2, 0, 0), 1.0),
        solids.capsule((-1, 0, 0), (1, 1, 0), 0.4),
        solids.cylinder((-1, 0, 0.5), (1, 1, 0), 0.8, 0.3, rounding=0.1),
        solids.torus((0, 0, 0), (1, 1, 0), 1.5, 0.3),
        solids.prism([(-1, -1), (1, -1), (0.2, 0), (1, 1), (-1, 1)], axis=2, low=-1, high=1),
        solids.moved(solids.box((0, 0, 0), (1, 2, 3)), (0.5, 0, 0), (20, 30, 40)),
    ],
)
def test_distances_have_unit_slope_and_lead_to_the_surface(
    sdf: solids.Sdf, points: np.ndarray
) -> None:
    step = 1e-6
    slopes = [(sdf(points + step * e) - sdf(points - step * e)) / (2 * step) for e in np.eye(3)]
    gradient = np.stack(slopes, axis=1)
    outside = sdf(points) > 0.05
    np.testing.assert_allclose(np.linalg.norm(gradient[outside], axis=1), 1.0, atol=1e-4)
    landed = points - sdf(points)[:, None] * gradient
    np.testing.assert_allclose(sdf(landed)[outside], 0.0, atol=1e-4)


def test_combinations_are_set_operations(points: np.ndarray) -> None:
    a, b = solids.sphere((0, 0, 0), 1.5), solids.box((1, 0, 0), (2, 2, 2))
    in_a, in_b = a(points) < 0, b(points) < 0
    np.testing.assert_array_equal(solids.union(a, b)(points) < 0, in_a | in_b)
    np.testing.assert_array_equal(solids.intersect(a, b)(points) < 0, in_a & in_b)
    np.testing.assert_array_equal(solids.subtract(a, b)(points) < 0, in_a & ~in_b)
    fillet = solids.union(a, b, smooth=0.5)(points)
    assert (fillet <= np.minimum(a(points), b(points))).all()
    far = np.abs(a(points) - b(points)) > 0.5
    np.testing.assert_array_equal(fillet[far], np.minimum(a(points), b(points))[far])


def test_moved_and_mirrored(points: np.ndarray) -> None:
    turn = Rotation.from_euler("xyz", (10, 20, 30), degrees=True)
    part = solids.capsule((1, 0, 0), (2, 1, 0), 0.3)
    offset = np.array([0.1, 0.2, 0.3])
    placed = solids.moved(part, offset, (10, 20, 30))
    np.testing.assert_allclose(placed(turn.apply(points) + offset), part(points), atol=1e-12)
    pair = solids.mirrored(part, axis=0)
    np.testing.assert_array_equal(pair(points), pair(points * (-1, 1, 1)))
    np.testing.assert_array_equal(pair(points)[points[:, 0] > 0], part(points)[points[:, 0] > 0])


def test_colors_follow_regions_and_nearest_parts() -> None:
    red, blue, green = (1, 0, 0), (0, 0, 1), (0, 1, 0)
    left, right = solids.sphere((-1, 0, 0), 0.5), solids.sphere((1, 0, 0), 0.5)
    parts = solids.colored_parts((left, red), (right, blue))
    at = np.array([(-1.5, 0, 0), (1.5, 0, 0), (1, 0, 0.5)])
    np.testing.assert_array_equal(parts(at, at), [red, blue, blue])
    spot = solids.painted(parts, (solids.sphere((1, 0, 0.5), 0.1), green))
    np.testing.assert_array_equal(spot(at, at), [red, blue, green])
