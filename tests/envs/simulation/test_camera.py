"""Cameras against closed forms and OpenCV."""

import cv2
import numpy as np
import pytest
from two_view_pose.core.geometry import LINEMOD_K, invert
from two_view_pose.envs.simulation.camera import (
    CameraRange,
    frustum,
    look_at,
    opencv_to_opengl,
    view_sphere_pose,
)


def test_look_at_puts_its_target_on_the_optical_axis_with_level_rows() -> None:
    position, target = np.array([0.7, -0.4, 0.5]), np.array([0.1, 0.0, 0.05])
    T = look_at(position, target)
    rotation, _ = cv2.Rodrigues(T[:3, :3])
    K = LINEMOD_K.copy()
    uv, _ = cv2.projectPoints(target[None], rotation, T[:3, 3], K, None)
    np.testing.assert_allclose(uv[0, 0], K[:2, 2], atol=1e-6)
    assert T[0, 2] == pytest.approx(0.0, abs=1e-12)  # the image's x axis is level
    assert T[1, 2] < 0  # up in the world is up in the image
    np.testing.assert_allclose(invert(T)[:3, 3], position)


def test_roll_rotates_the_image_clockwise_about_its_center() -> None:
    center = np.array([0.0, 0.0, 0.1])
    straight = view_sphere_pose(center, 1.0, 0.3, 0.5)
    rolled = view_sphere_pose(center, 1.0, 0.3, 0.5, roll=0.2)
    turn = (rolled @ invert(straight))[:3, :3]
    np.testing.assert_allclose(turn[2], (0, 0, 1), atol=1e-12)
    assert np.arccos(turn[0, 0]) == pytest.approx(0.2)


@pytest.mark.parametrize("elevation", [-np.pi / 2, 0.0, np.pi / 2])
def test_view_sphere_keeps_its_distance_even_straight_above(elevation: float) -> None:
    center = np.array([0.2, 0.1, 0.0])
    T = view_sphere_pose(center, 0.8, 1.0, elevation)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ center + T[:3, 3], (0, 0, 0.8), atol=1e-12)


def test_opengl_looks_along_minus_z_and_the_conversion_inverts_itself() -> None:
    T = view_sphere_pose(np.zeros(3), 1.0, 0.4, 0.6)
    np.testing.assert_allclose((opencv_to_opengl(T) @ (0, 0, 0, 1))[:3], (0, 0, -1), atol=1e-12)
    np.testing.assert_array_equal(opencv_to_opengl(opencv_to_opengl(T)), T)


def test_frustum_corners_are_the_outer_corners_of_the_corner_pixels() -> None:
    K = np.array([[500.0, 0, 300.2], [0, 510.0, 90.7], [0, 0, 1]])
    left, right, bottom, top = frustum(K, 240, 400, near=0.05)
    corners = np.array([[left, -top, 0.05], [right, -bottom, 0.05]])  # OpenCV's y points down
    uv, _ = cv2.projectPoints(corners, np.zeros(3), np.zeros(3), K, None)
    np.testing.assert_allclose(uv[:, 0], [(-0.5, -0.5), (399.5, 239.5)], atol=1e-9)
    skewed = K + np.array([[0, 3.0, 0], [0, 0, 0], [0, 0, 0]])
    with pytest.raises(ValueError, match="skew"):
        frustum(skewed, 240, 400, near=0.05)


def test_camera_range_is_kept_and_filled() -> None:
    rng = np.random.default_rng(0)
    center = np.array([0.1, -0.2, 0.05])
    cameras = CameraRange(roll=0.2, look_at_noise=0.15)
    views = np.array([cameras.sample(rng, center) for _ in range(500)])
    positions = invert(views)[:, :3, 3] - center
    distance = np.linalg.norm(positions, axis=1)
    elevation = np.rad2deg(np.arcsin(positions[:, 2] / distance))
    assert 0.6 <= distance.min() < 0.63 and 1.37 < distance.max() <= 1.4
    assert 7 <= elevation.min() < 9 and 80 < elevation.max() <= 82
    in_camera = views[:, :3, :3] @ center + views[:, :3, 3]
    slopes = np.abs(in_camera[:, :2] / in_camera[:, 2:])
    assert 0.15 < slopes.max() < 0.26


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("distance", (1.0, 0.5)),
        ("distance", (0.0, 1.0)),
        ("elevation", (7.0, 82.0)),
        ("roll", -1.0),
    ],
)
def test_impossible_ranges_are_refused(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        CameraRange(**{field: value})


def test_a_camera_cannot_look_at_where_it_stands() -> None:
    with pytest.raises(ValueError, match="cannot look"):
        look_at(np.ones(3), np.ones(3))
