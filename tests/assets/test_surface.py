"""Keypoints, points, diameters and resting poses against brute force and closed forms."""

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
