"""Keypoints, points, diameters and resting poses against brute force and closed forms."""

import time
import tracemalloc

import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import cdist, pdist
from two_view_pose.assets import surface


def test_farthest_points_against_brute_force() -> None:
    points = np.random.default_rng(0).normal(size=(60, 3))
    chosen = surface.farthest_points(points, 10, start=7)
    expected = [7]
    while len(expected) < 10:
        expected.append(int(cdist(points, points[expected]).min(axis=1).argmax()))
    assert chosen.tolist() == expected


def test_keypoints_are_closed_under_symmetries() -> None:
    mesh = trimesh.creation.box(extents=(0.1, 0.06, 0.2))
    symmetries = np.stack([np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])])
    keypoints = surface.keypoints(mesh.vertices, np.zeros(3), symmetries)
    rotated = keypoints @ symmetries[1, :3, :3].T
    assert cdist(rotated, keypoints).min(axis=1).max() < 1e-12
    assert pdist(keypoints).min() > 0


def test_diameter_against_all_pairs() -> None:
    vertices = np.random.default_rng(0).normal(size=(300, 3))
    assert surface.diameter(vertices) == pytest.approx(pdist(vertices).max(), rel=1e-12)


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (1.0, 0.9, 0.4)])
def test_diameter_of_many_hull_vertices(axes: tuple[float, float, float]) -> None:
    directions = np.random.default_rng(0).normal(size=(9000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for vertices in (directions * axes, directions * axes + 0.3 * np.abs(directions)):
        blocks = (cdist(block, vertices).max() for block in np.array_split(vertices, 20))
        assert surface.diameter(vertices) == pytest.approx(max(blocks), rel=1e-12)


@pytest.mark.slow
def test_a_fine_ball_takes_seconds_and_little_memory() -> None:
    directions = np.random.default_rng(0).normal(size=(160_000, 3))
    ball = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    tracemalloc.start()
    start = time.process_time()
    assert 2 - 1e-7 < surface.diameter(ball) <= 2 + 1e-12
    seconds, (_, peak) = time.process_time() - start, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert seconds < 40 and peak < 1e9  # all pairs: minutes, and 25 GiB in eight blocks


def test_a_ball_has_no_thousand_stable_poses() -> None:
    ball = trimesh.creation.icosphere(4, 0.05)
    start = time.process_time()
    poses = surface.stable_poses(ball)
    assert time.process_time() - start < 5
    assert len(poses) == 1 and poses[0, 2, 3] == pytest.approx(0.05, rel=0.01)


@pytest.mark.parametrize("count", [100, 600])
def test_thinning_keeps_flat_parts_whose_vertices_are_doubled(count: int) -> None:
    plate = trimesh.creation.box((0.12, 0.08, 0.004))
    for _ in range(4):
        plate = plate.subdivide()
    doubled = plate.vertices[plate.faces].reshape(-1, 3)  # every triangle has its own
    faces = np.arange(len(doubled)).reshape(-1, 3)
    thinned = trimesh.Trimesh(*surface.simplified(doubled, faces, count, 5.0), process=False)
    assert len(thinned.faces) < len(plate.faces)
    assert thinned.area == pytest.approx(2 * (0.12 * 0.08 + 0.2 * 0.004), rel=0.02)


def test_a_box_rests_on_its_six_sides() -> None:
    sides = np.array([0.1, 0.06, 0.2])
    poses = surface.stable_poses(trimesh.creation.box(extents=sides))
    assert len(poses) == 6
    np.testing.assert_array_equal(poses[0, :3, :3], np.eye(3))
    heights = np.sort(poses[:, 2, 3])
    np.testing.assert_allclose(heights, np.repeat(np.sort(sides / 2), 2), atol=1e-9)
    # The larger the side, the likelier.
    assert poses[1, 2, 3] == pytest.approx(0.03)
    assert sorted({tuple(np.round(T[2, :3], 6) + 0.0) for T in poses}) == sorted(
        {tuple(sign * axis + 0.0) for axis in np.eye(3) for sign in (-1, 1)}
    )


def test_stable_poses_without_an_upright_one() -> None:
    cone = trimesh.creation.cone(radius=0.02, height=0.2, sections=24)
    cone.apply_transform(np.diag([1.0, -1.0, -1.0, 1.0]))  # on its tip
    assert surface.support_margin(cone, tolerance=1e-4) < 0
    poses = surface.stable_poses(cone)
    assert (poses[:, 2, 2] < 0.99).all()
    for T in poses:
        placed = trimesh.transform_points(cone.vertices, T)
        assert placed[:, 2].min() == pytest.approx(0.0, abs=1e-9)


def test_support_margin_of_a_box() -> None:
    box = trimesh.creation.box(extents=(0.1, 0.06, 0.2))
    assert surface.support_margin(box, tolerance=1e-4) == pytest.approx(0.03)
    box.vertices[:, 0] += 2.0 * box.vertices[:, 2]  # leans over: shifts the center of mass by 0.2
    assert surface.support_margin(box, tolerance=1e-4) == pytest.approx(-0.15)
