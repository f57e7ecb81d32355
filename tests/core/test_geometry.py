"""Cameras and transforms against OpenCV and SciPy, and validation."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import (
    LINEMOD_K,
    View,
    check_image,
    check_intrinsics,
    check_rigid,
    crop_matrix,
    invert,
    make_transform,
    project,
    rotation_to_6d,
    transform,
)


def some_pose(rng: np.random.Generator) -> np.ndarray:
    return make_transform(
        Rotation.random(rng=rng).as_matrix(), rng.normal(size=3) * 0.1 + [0, 0, 1]
    )


def test_projection_is_opencvs():
    rng = np.random.default_rng(0)
    T, points = some_pose(rng), rng.normal(size=(20, 3)) * 0.1
    expected, _ = cv2.projectPoints(
        points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], LINEMOD_K, np.zeros(4)
    )
    np.testing.assert_allclose(project(transform(T, points), LINEMOD_K), expected[:, 0], atol=1e-6)


def test_invert_is_the_matrix_inverse():
    rng = np.random.default_rng(1)
    T = np.stack([some_pose(rng) for _ in range(5)])
    np.testing.assert_allclose(invert(T), np.linalg.inv(T), atol=1e-12)
    points = rng.normal(size=(4, 3))
    np.testing.assert_allclose(transform(invert(T[0]), transform(T[0], points)), points, atol=1e-12)


def test_crop_matrix_keeps_pixel_centers():
    """The crop's camera sees a point where OpenCV's warp puts the pixel."""
    crop = crop_matrix(np.array([320.0, 240.0]), side=64.0, size=128)
    np.testing.assert_allclose(crop @ [320.0, 240.0, 1.0], [63.5, 63.5, 1.0])
    # The crop's borders, half a pixel outside the outermost centers, are `side` apart.
    edges = np.linalg.solve(crop, [[-0.5, 127.5], [63.5, 63.5], [1.0, 1.0]])
    assert edges[0, 1] - edges[0, 0] == pytest.approx(64.0)

    image = np.zeros((480, 640), np.float32)
    cv2.circle(image, (330, 250), 6, 1.0, -1)
    warped = cv2.warpAffine(image, crop[:2], (128, 128), flags=cv2.INTER_LINEAR)
    rows, columns = np.indices(warped.shape)
    centroid = np.array([(columns * warped).sum(), (rows * warped).sum()]) / warped.sum()
    np.testing.assert_allclose((crop @ [330.0, 250.0, 1.0])[:2], centroid, atol=0.02)


def test_rotation_to_6d_determines_the_rotation():
    rotation = Rotation.random(rng=np.random.default_rng(2)).as_matrix()
    first, second = rotation_to_6d(rotation).reshape(2, 3)
    rebuilt = np.stack([first, second, np.cross(first, second)], axis=1)
    np.testing.assert_allclose(rebuilt, rotation, atol=1e-12)


def test_view_validates():
    image = np.zeros((4, 6, 3), np.uint8)
    view = View(image, LINEMOD_K.astype(np.float32), np.eye(4, dtype=np.float32))
    assert view.K.dtype == view.T_cam_world.dtype == np.float64
    with pytest.raises(ValueError, match="T_cam_world"):
        View(image, LINEMOD_K, 2 * np.eye(4))


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(4), r"3x3 camera matrix, got shape \(4, 4\)"),
        (np.full((3, 3), np.nan), "NaN or infinite"),
        (np.diag([-500.0, 500.0, 1.0]), "positive focal lengths, got -500.0"),
        (np.diag([500.0, 500.0, 2.0]), r"row \(0, 0, 1\), got \[0.0, 0.0, 2.0\]"),
    ],
)
def test_bad_intrinsics(matrix: np.ndarray, message: str):
    with pytest.raises(ValueError, match=message):
        check_intrinsics(matrix)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(3), r"4x4 rigid transform, got shape \(3, 3\)"),
        (np.full((4, 4), np.inf), "NaN or infinite"),
        (np.ones((4, 4)), r"row \(0, 0, 0, 1\)"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "determinant -1"),
        (np.diag([2.0, 1.0, 0.5, 1.0]), "not rigid"),
    ],
)
def test_bad_transforms(matrix: np.ndarray, message: str):
    with pytest.raises(ValueError, match=message):
        check_rigid(matrix)


@pytest.mark.parametrize(
    "image",
    [np.zeros((4, 6), np.uint8), np.zeros((4, 6, 4), np.uint8), np.zeros((4, 6, 3), np.float32)],
)
def test_bad_images(image: np.ndarray):
    with pytest.raises(ValueError, match=f"got {image.dtype} of shape"):
        check_image(image)


VALID_VIEW = {"image": np.zeros((4, 4, 3), np.uint8), "K": LINEMOD_K, "T_cam_world": np.eye(4)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"K": np.eye(4)}, "K must be a 3x3"),
        ({"K": LINEMOD_K * np.nan}, "K has NaN"),
        ({"K": -LINEMOD_K}, "positive focal"),
        ({"image": np.zeros((4, 4, 3))}, "image must be uint8"),
        ({"image": np.zeros((4, 4), np.uint8)}, "image must be uint8"),
        ({"image": np.zeros((4, 4, 4), np.uint8)}, "image must be uint8"),
        ({"image": np.zeros((0, 4, 3), np.uint8)}, "image"),
        ({"T_cam_world": np.diag([2.0, 2, 2, 1])}, "T_cam_world is not rigid"),
        ({"T_cam_world": np.diag([1.0, 1, -1, 1])}, "T_cam_world is not rigid"),
        ({"T_cam_world": np.eye(3)}, "T_cam_world must be a 4x4"),
        ({"T_cam_world": np.full((4, 4), np.nan)}, "T_cam_world has NaN"),
    ],
)
def test_wrong_views_are_refused_by_name(changes, message):
    with pytest.raises(ValueError, match=message):
        View(**(VALID_VIEW | changes))
