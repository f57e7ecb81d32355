"""Draws a posed object into an image: its silhouette and its outline."""

from collections.abc import Mapping
from typing import Protocol

import cv2
import numpy as np

from ..core.geometry import check_image, check_intrinsics, check_rigid, transform

TRUE_COLOR = (57, 190, 88)
ESTIMATE_COLOR = (255, 122, 26)

MAX_OVERLAY_SIDE = 1920
"""Pixels: larger photographs are scaled down for an overlay, whose lines would be too thin."""

_MIN_DEPTH = 0.01  # meters; nearer faces are left out of a silhouette
_SHIFT = 4  # cv2's fixed point: 1/16 of a pixel
_THICKNESS = 2  # pixels
_MAX_PIXEL = 2**20 / 2**_SHIFT  # coordinates are clipped to it, for cv2's fixed point


class Shape(Protocol):
    """An object that can be drawn: vertices (V, 3) in meters and faces (F, 3) of indices."""

    @property
    def vertices(self) -> np.ndarray: ...

    @property
    def faces(self) -> np.ndarray: ...


def silhouette(
    model: Shape, T_cam_obj: np.ndarray, K: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """Returns the mask of the pixels that the object alone would cover.

    Args:
        model: the object.
        T_cam_obj: object to OpenCV camera, (4, 4), meters.
        K: camera matrix, (3, 3), pixels.
        shape: height and width of the image.

    Returns:
        (height, width), uint8, 255 inside; faces behind the camera are left out.

    Raises:
        InputError: if the pose is not rigid or K is not a camera matrix.
    """
    K = check_intrinsics(K)
    vertices = transform(check_rigid(T_cam_obj, "T_cam_obj"), model.vertices)
    mask = np.zeros(shape, dtype=np.uint8)
    in_front = (vertices[:, 2] > _MIN_DEPTH)[model.faces].all(axis=1)
    uvw = vertices @ K.T
    pixels = np.clip(uvw[:, :2] / np.maximum(uvw[:, 2:], _MIN_DEPTH), -_MAX_PIXEL, _MAX_PIXEL)
    triangles = pixels[model.faces[in_front]]
    for triangle in np.round(triangles * 2**_SHIFT).astype(np.int32):
        cv2.fillConvexPoly(mask, triangle, 255, cv2.LINE_8, _SHIFT)
    return mask


def outline(
    model: Shape, T_cam_obj: np.ndarray, K: np.ndarray, shape: tuple[int, int]
) -> list[np.ndarray]:
    """Returns the contours of the :func:`silhouette`, holes included.

    Returns:
        Closed contours, each (N, 2) float64 pixels; none if the object is out of the image.
    """
    # Contours run along pixel centers: rasterize finer, with a margin that the frame cuts off.
    scale, margin = 3, 4
    offset = scale * margin + (scale - 1) / 2
    lift = np.array([[scale, 0.0, offset], [0.0, scale, offset], [0.0, 0.0, 1.0]])
    fine_shape = (scale * (shape[0] + 2 * margin), scale * (shape[1] + 2 * margin))
    mask = silhouette(model, T_cam_obj, lift @ check_intrinsics(K), fine_shape)
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    return [
        (contour.reshape(-1, 2) - lift[:2, 2]) / scale for contour in contours if len(contour) > 8
    ]


def draw_poses(
    image: np.ndarray, model: Shape, poses: Mapping[tuple[int, int, int], np.ndarray], K: np.ndarray
) -> np.ndarray:
    """Returns a copy of the image with the object outlined in each pose, anti-aliased.

    Args:
        image: RGB uint8, (H, W, 3).
        model: the object.
        poses: T_cam_obj (4, 4) by the RGB color to draw it in; later ones lie on top.
        K: camera matrix of the image, (3, 3).

    Raises:
        InputError: if the image is not uint8 RGB, a pose is not rigid or K is not a camera matrix.
    """
    canvas = np.ascontiguousarray(check_image(image)).copy()
    for color, T_cam_obj in poses.items():
        contours = outline(model, T_cam_obj, K, image.shape[:2])
        polygons = [np.round(contour * 2**_SHIFT).astype(np.int32) for contour in contours]
        if polygons:
            cv2.polylines(canvas, polygons, True, color, _THICKNESS, cv2.LINE_AA, _SHIFT)
    return canvas


def draw_overlay(
    image: np.ndarray, model: Shape, poses: Mapping[tuple[int, int, int], np.ndarray], K: np.ndarray
) -> np.ndarray:
    """`draw_poses` on an image that is scaled down to `MAX_OVERLAY_SIDE` where it is larger."""
    height, width = check_image(image).shape[:2]
    factor = MAX_OVERLAY_SIDE / max(height, width)
    if factor >= 1:
        return draw_poses(image, model, poses, K)
    small = (max(1, round(factor * width)), max(1, round(factor * height)))
    x, y = small[0] / width, small[1] / height
    # Pixel centers: 0 is the center of the first pixel of both.
    scaled = np.array([[x, 0.0, (x - 1) / 2], [0.0, y, (y - 1) / 2], [0.0, 0.0, 1.0]]) @ K
    return draw_poses(cv2.resize(image, small, interpolation=cv2.INTER_AREA), model, poses, scaled)
