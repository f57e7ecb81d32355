"""Silhouettes and outlines against closed forms and OpenCV's projection."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import trimesh
from two_view_pose.core.geometry import LINEMOD_K, make_transform, project, transform
from two_view_pose.pose_estimator.visualization import draw_overlay, draw_poses, outline, silhouette

SHAPE = (480, 640)


def model(mesh: trimesh.Trimesh) -> SimpleNamespace:
    return SimpleNamespace(vertices=np.array(mesh.vertices), faces=np.array(mesh.faces))


@pytest.fixture
def box() -> SimpleNamespace:
    return model(trimesh.creation.box((0.12, 0.08, 0.05)))


@pytest.fixture
def T_cam_obj() -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.4, -0.7, 0.2]))[0]
    T[:3, 3] = (0.05, -0.03, 0.7)
    return T


def test_box_is_its_projected_hull(box, T_cam_obj):
    rvec, tvec = cv2.Rodrigues(T_cam_obj[:3, :3])[0], T_cam_obj[:3, 3]
    pixels = cv2.projectPoints(box.vertices, rvec, tvec, LINEMOD_K, None)[0].reshape(-1, 2)
    hull = cv2.convexHull(pixels.astype(np.float32))
    area = np.count_nonzero(silhouette(box, T_cam_obj, LINEMOD_K, SHAPE))
    assert area == pytest.approx(cv2.contourArea(hull), rel=0.04)
    (contour,) = outline(box, T_cam_obj, LINEMOD_K, SHAPE)
    away = [abs(cv2.pointPolygonTest(hull, (float(u), float(v)), True)) for u, v in contour]
    assert max(away) < 0.7


def test_a_ring_has_a_hole():
    ring = model(trimesh.creation.annulus(0.03, 0.06, 0.01))
    T = np.eye(4)
    T[2, 3] = 0.5
    contours = outline(ring, T, LINEMOD_K, SHAPE)
    center = LINEMOD_K[:2, 2]
    radii = sorted(np.linalg.norm(c - center, axis=1).mean() for c in contours)
    # The nearer rim bounds the outside, the farther or nearer one the hole.
    np.testing.assert_allclose(radii[1], 0.06 * 573 / 0.495, rtol=0.01)
    np.testing.assert_allclose(radii[0], 0.03 * 573 / 0.5, rtol=0.02)


def test_nothing_behind_the_camera(box, T_cam_obj):
    T_cam_obj[2, 3] = -0.7
    assert not silhouette(box, T_cam_obj, LINEMOD_K, SHAPE).any()
    assert outline(box, T_cam_obj, LINEMOD_K, SHAPE) == []


@pytest.mark.parametrize("depth", [0.0, 0.02, 0.05, 400.0])
def test_extreme_positions_are_drawn(box, T_cam_obj, depth):
    T_cam_obj[:3, 3] = (30.0 * (depth > 1), 0.0, depth)
    image = np.zeros((*SHAPE, 3), np.uint8)
    assert draw_poses(image, box, {(255, 0, 0): T_cam_obj}, LINEMOD_K).shape == image.shape


def test_drawing_does_not_change_its_input(box, T_cam_obj):
    image = np.full((*SHAPE, 3), 9, np.uint8)
    drawn = draw_poses(image, box, {(250, 120, 20): T_cam_obj}, LINEMOD_K)
    assert (image == 9).all()
    (contour,) = outline(box, T_cam_obj, LINEMOD_K, SHAPE)
    u, v = np.round(contour).astype(int).T
    np.testing.assert_allclose(drawn[v, u].mean(axis=0), (250, 120, 20), atol=40)
    far = np.ones(SHAPE, bool)
    cv2.fillConvexPoly(mask := np.zeros(SHAPE, np.uint8), np.stack([u, v], 1), 1)
    far &= cv2.dilate(mask, np.ones((9, 9))) == 0
    assert (drawn[far] == 9).all()


def test_bad_input(box, T_cam_obj):
    with pytest.raises(ValueError, match="uint8 RGB"):
        draw_poses(np.zeros((4, 4)), box, {(0, 0, 0): T_cam_obj}, LINEMOD_K)
    with pytest.raises(ValueError, match="K must be"):
        outline(box, T_cam_obj, np.eye(4), SHAPE)
    with pytest.raises(ValueError, match="T_cam_obj"):
        outline(box, 2 * T_cam_obj, LINEMOD_K, SHAPE)


def test_an_overlay_of_a_large_photograph_is_small_and_in_place(box):
    K = np.array([[4000.0, 0, 2999.5], [0, 4000, 1999.5], [0, 0, 1]])
    T = make_transform(np.eye(3), [0.3, -0.15, 0.9])
    image = np.zeros((4000, 6000, 3), np.uint8)
    drawn = draw_overlay(image, box, {(255, 0, 0): T}, K)
    assert drawn.shape == (1280, 1920, 3)
    rows, columns = np.nonzero(drawn[..., 0] > 128)
    u, v = project(transform(T, box.vertices), K).T
    # Pixel centers of both sizes, as cv2.resize has them.
    for found, expected in ((columns, u), (rows, v)):
        ends = (np.array([expected.min(), expected.max()]) + 0.5) * 0.32 - 0.5
        np.testing.assert_allclose([found.min(), found.max()], ends, atol=2)
    small = np.zeros((480, 640, 3), np.uint8)
    expected = draw_poses(small, box, {(255, 0, 0): T}, LINEMOD_K)
    np.testing.assert_array_equal(draw_overlay(small, box, {(255, 0, 0): T}, LINEMOD_K), expected)
