"""Symmetry groups with continuous axes: bounded, true symmetries, and written as what they are."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.solid_scenes import solid
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from two_view_pose.core.errors import InputError
from two_view_pose.core.geometry import invert, make_transform, transform
from two_view_pose.pose_estimator.bop.models import write_evaluation_models, write_models
from two_view_pose.pose_estimator.bop.models_info import read_models_info
from two_view_pose.pose_estimator.bop.symmetries import all_symmetries, split_continuous
from two_view_pose.pose_estimator.symmetry import canonical_pose

X, Y, Z = np.eye(3)
NONE = np.empty((0, 4, 4))
CENTER = np.array([0.01, -0.02, 0.03])


def axes(*directions: np.ndarray, point: np.ndarray = CENTER) -> np.ndarray:
    return np.stack([[*direction, *point] for direction in directions])


def turn(axis: np.ndarray, degrees: float, point: np.ndarray = CENTER) -> np.ndarray:
    rotation = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
    return make_transform(rotation, point - rotation @ point)


HALF_TURN = turn(X, 180)[None]


def write_info(root: Path, **entry: object) -> None:
    (root / "models").mkdir()
    numbers = {"diameter": 100} | {f"{p}_{axis}": 5 for p in ("min", "size") for axis in "xyz"}
    (root / "models/models_info.json").write_text(json.dumps({"1": numbers | entry}))


@pytest.mark.parametrize(
    ("discrete", "continuous", "shape"),
    [
        (NONE, axes(Z), "cone"),
        (NONE, axes(Z, -2 * Z), "cone"),
        (turn(Z, 40)[None], axes(Z), "cone"),
        (HALF_TURN, axes(Z), "cylinder"),
        (np.stack([turn(X, 180), turn(Y, 180), turn(Z, 180)]), axes(Z), "cylinder"),
        (NONE, axes(X, Y), "ball"),
        (NONE, axes(X, Y, Z), "ball"),
        (turn(X, 90)[None], axes(Z), "ball"),
    ],
)  # fmt: skip
def test_products_of_axes_are_bounded_and_keep_the_surface(discrete, continuous, shape):
    """trimesh's bodies of revolution, compared as dense points with themselves, moved."""
    body = {
        "cone": lambda: trimesh.creation.cone(0.04, 0.09, sections=72),
        "cylinder": lambda: trimesh.creation.cylinder(0.04, 0.09, sections=72),
        "ball": lambda: trimesh.creation.icosphere(4, 0.05),
    }[shape]()
    points = trimesh.sample.sample_surface(body, 20_000, seed=0)[0] + CENTER
    symmetries = all_symmetries(discrete, continuous)
    assert len(symmetries) == {"cone": 72, "cylinder": 144, "ball": 1000}[shape]
    np.testing.assert_allclose(symmetries[0], np.eye(4), atol=1e-12)
    tree = cKDTree(points)
    for T in symmetries[:: len(symmetries) // 36]:
        assert tree.query(transform(T, points[::200]))[0].mean() < 2e-3
    # No rotation is far from all of those listed.
    known = Rotation.from_matrix(symmetries[:, :3, :3])
    if shape == "ball":
        some = Rotation.random(100, rng=np.random.default_rng(0))
        assert max((known * r.inv()).magnitude().min() for r in some) < np.radians(20)
    angles = np.sort([T[0, 0] for T in symmetries if T[2, 2] > 0.999])
    assert shape == "ball" or (angles[0] < -0.99 and angles[-1] > 0.999)


def test_a_group_without_axes_is_as_listed():
    quarter = np.stack([turn(Z, angle) for angle in (90, 180, 270)])
    np.testing.assert_array_equal(all_symmetries(quarter, np.empty((0, 6)))[1:], quarter)
    again, none = split_continuous(all_symmetries(quarter, np.empty((0, 6))))
    np.testing.assert_array_equal(again, quarter)
    assert none.shape == (0, 6)


@pytest.mark.parametrize(
    ("discrete", "continuous", "counts"),
    [
        (NONE, axes(Z), (0, 1)),
        (HALF_TURN, axes(np.array([0.0, 0.6, 0.8])), (1, 1)),
        (NONE, axes(X, Y, Z), (0, 3)),
        (np.stack([turn(X, 180), turn(Y, 180), turn(Z, 180)]), np.empty((0, 6)), (3, 0)),
    ],
)
@pytest.mark.parametrize("write", [write_models, write_evaluation_models])
def test_continuous_symmetries_are_written_as_continuous(
    discrete, continuous, counts, write, tmp_path
):
    symmetries = all_symmetries(discrete, continuous)
    write(tmp_path, [replace(solid("crate"), symmetries=symmetries)])
    folder = "models" if write is write_models else "models_eval"
    info = read_models_info(tmp_path, folder)[7]
    assert (len(info.discrete), len(info.axes)) == counts
    assert (tmp_path / folder / "models_info.json").stat().st_size < 2000
    assert len(info.symmetries) == len(symmetries)
    for T in symmetries[:: max(1, len(symmetries) // 20)]:
        assert np.abs(invert(T) @ info.symmetries - np.eye(4)).max(axis=(1, 2)).min() < 1e-6


@pytest.mark.parametrize("axis", [[0, 0, 0], [0.0, -0.0, 1e-300]])
def test_an_axis_without_direction_is_refused(axis, tmp_path):
    write_info(tmp_path, symmetries_continuous=[{"axis": axis, "offset": [0, 0, 0]}])
    with pytest.raises(InputError, match=r"object 1, symmetries_continuous 0: .* has no axis"):
        read_models_info(tmp_path)


def test_axes_that_do_not_meet_are_refused(tmp_path):
    lines = [{"axis": [0, 0, 1], "offset": [0, 0, 0]}, {"axis": [0, 0, 1], "offset": [9, 0, 0]}]
    write_info(tmp_path, symmetries_continuous=lines)
    with pytest.raises(InputError, match=r"object 1: .* has axes that do not meet"):
        read_models_info(tmp_path)


def test_a_ball_has_one_label_for_all_its_rotations():
    symmetries = all_symmetries(NONE, axes(X, Y, point=np.zeros(3)))
    rotations = Rotation.random(20, rng=np.random.default_rng(1)).as_matrix()
    poses = [make_transform(R, np.array([0.1, -0.05, 0.9])) for R in rotations]
    labels = Rotation.from_matrix([canonical_pose(T, symmetries)[:3, :3] for T in poses])
    assert (labels * labels[0].inv()).magnitude().max() < np.radians(45)
