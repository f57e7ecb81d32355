"""Each mistake, made with SciPy and by hand, is undone by its correction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import make_transform
from two_view_pose.pose_estimator.bop.pose_mistakes import corrections

K = np.array([[570.0, 0, 325], [0, 572, 242], [0, 0, 1]])
SIZE = (480, 640)
R = Rotation.from_euler("xyz", [0.3, -1.1, 2.0])
T = make_transform(R.as_matrix(), np.array([0.1, -0.05, 0.9]))


def reordered(order: list[int]) -> np.ndarray:
    return make_transform(Rotation.from_quat(R.as_quat()[order]).as_matrix(), T[:3, 3])


def in_blender() -> np.ndarray:
    """The camera's pose in the object's frame, x right, y up, z backward."""
    T_obj_cam = np.linalg.inv(T)
    axes = T_obj_cam[:3, :3] @ np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1.0]])
    return make_transform(axes, T_obj_cam[:3, 3])


MISTAKES: dict[str, Callable[[], np.ndarray]] = {
    "meters": lambda: make_transform(T[:3, :3], T[:3, 3] / 1000),
    "twice millimeters": lambda: make_transform(T[:3, :3], T[:3, 3] * 1000),
    "opengl": lambda: np.diag([1.0, -1, -1, 1]) @ T,
    "inverse": lambda: np.linalg.inv(T),
    "inverse of opengl": in_blender,
    "transposed": lambda: make_transform(T[:3, :3].T, T[:3, 3]),
    # Reading (w, x, y, z) as (x, y, z, w) takes w for x.
    "quaternion wxyz": lambda: reordered([3, 0, 1, 2]),
    "quaternion xyzw": lambda: reordered([1, 2, 3, 0]),
    "meters opengl": lambda: np.diag([1e-3, -1e-3, -1e-3, 1]) @ T @ np.diag([1e3, 1e3, 1e3, 1]),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_wrong_pose_is_corrected(name):
    found = {c.name: c for c in corrections(MISTAKES[name](), K, SIZE)}
    np.testing.assert_allclose(found[name].T_cam_obj, T, atol=1e-9)
    np.testing.assert_array_equal(found[name].K, K)
    assert found[name].cause and found[name].remedy


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("K swapped", [[325.0, 0, 570], [0, 242, 572], [0, 0, 1]]),
        ("K times 0.5", [[1140.0, 0, 650], [0, 1144, 484], [0, 0, 1]]),
        ("K times 2", [[285.0, 0, 162.5], [0, 286, 121], [0, 0, 1]]),
    ],
)
def test_wrong_camera_matrix_is_corrected(name, wrong):
    found = {c.name: c for c in corrections(T, np.array(wrong), SIZE)}
    np.testing.assert_allclose(found[name].K, K)
    np.testing.assert_array_equal(found[name].T_cam_obj, T)


def test_corrections_keep_the_principal_point_central():
    for correction in corrections(T, K, SIZE):
        assert 0.3 < correction.K[0, 2] / SIZE[1] < 0.7
