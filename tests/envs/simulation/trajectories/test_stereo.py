"""Stereo rigs: the baseline is exact, and a point is seen on one row by both cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from two_view_pose.core.geometry import invert
from two_view_pose.envs.datagen.generate import GenerateConfig, generate
from two_view_pose.envs.simulation.camera import look_at
from two_view_pose.envs.simulation.trajectories.stereo import rig_frames, rig_pairs
from two_view_pose.pose_estimator.bop import dataset as bop

BASELINE = 0.1


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> GenerateConfig:
    config = GenerateConfig(
        tmp_path_factory.mktemp("data") / "set",
        scenes=2,
        views=4,
        objects=("ape", "duck"),
        scene="linemod",
        sampling="stereo",
        stereo_baseline=BASELINE,
        width=160,
        height=120,
        depth=True,
        randomize=False,
        workers=1,
        seed=2,
    )
    generate(config)
    return config


def test_the_right_camera_stands_to_the_right() -> None:
    left = look_at(np.array([0.5, -0.7, 0.4]), np.array([0.1, 0.0, 0.0]), roll=0.2)
    first, second = rig_frames([left], 0.25)
    np.testing.assert_array_equal(first, left)
    centers = [invert(T)[:3, 3] for T in (first, second)]
    np.testing.assert_allclose(centers[1] - centers[0], 0.25 * left[0, :3], atol=1e-12)
    np.testing.assert_array_equal(second[:3, :3], left[:3, :3])
    assert rig_pairs(6) == ((0, 1), (2, 3), (4, 5))


def test_pairs_are_left_and_right_at_exactly_the_baseline(config: GenerateConfig) -> None:
    pairs = bop.read_pairs(config.out)
    listed = [(p.scene_id, p.ref_image_id, p.second_image_id) for p in pairs]
    assert listed == [(s, left, left + 1) for s in (0, 1) for left in (0, 2)]
    assert [p.target_obj_id for p in pairs] == [1, 1, 9, 9]
    expected = np.eye(4)
    expected[0, 3] = -BASELINE
    for pair in pairs:
        assert pair.gap is None
        np.testing.assert_allclose(pair.T_second_ref, expected, atol=1e-12)


def test_epipolar_lines_are_rows_and_disparity_is_f_b_over_z(config: GenerateConfig) -> None:
    dataset = bop.read_dataset(config.out, config.split)
    checked = 0
    for pair in bop.read_pairs(config.out):
        images = dataset.scene(pair.scene_id)
        left, right = images[pair.ref_image_id], images[pair.second_image_id]
        z, other = bop.read_depth(left), bop.read_depth(right)
        v, u = np.mgrid[:120, :160].astype(float)
        rays = np.stack([u, v, np.ones_like(u)]).reshape(3, -1)
        points = (np.linalg.inv(left.K) @ rays * z.ravel()).T
        rotation, _ = cv2.Rodrigues(pair.T_second_ref[:3, :3])
        uv, _ = cv2.projectPoints(points, rotation, pair.T_second_ref[:3, 3], right.K, None)
        uv = uv[:, 0]
        np.testing.assert_allclose(uv[:, 1], v.ravel(), atol=1e-3)
        disparity = left.K[0, 0] * BASELINE / z.ravel()
        np.testing.assert_allclose(uv[:, 0], u.ravel() - disparity, atol=1e-3)
        # And the right camera does see them there, where nothing hides them.
        column, row = np.round(uv).astype(int).T
        inside = (column >= 0) & (column < 160)
        seen = other[row[inside], column[inside]]
        hit = np.abs(seen - z.ravel()[inside]) < 0.02
        assert hit.mean() > 0.75
        checked += inside.sum()
    assert checked > 10_000


def test_the_left_cameras_are_those_of_single_views(config: GenerateConfig) -> None:
    images = bop.read_dataset(config.out, config.split).scene(0)
    first, second = (images[i].T_cam_world for i in (0, 2))
    assert first is not None and second is not None
    turn = np.rad2deg(np.arccos(np.clip(first[2, :3] @ second[2, :3], -1, 1)))
    assert 5 < turn < 100


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": 3}, "views must be even with a stereo rig .* got 3"),
        ({"stereo_baseline": 0.0}, "stereo_baseline must be > 0 and <= 0.3 m, got 0.0"),
        ({"stereo_baseline": 12.0}, "stereo_baseline must be > 0 and <= 0.3 m, got 12.0"),
    ],
)
def test_wrong_settings_are_named(tmp_path: Path, change, message) -> None:
    with pytest.raises(ValueError, match=message):
        GenerateConfig(tmp_path, sampling="stereo", **change)
