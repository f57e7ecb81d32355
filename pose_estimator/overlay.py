"""Draws a model's outline over a picture, the way a person checks a pose."""

from __future__ import annotations

import cv2
import numpy as np

from ..assets.object_model import ObjectModel
from .geometry import project, transform

NEAREST = 0.01
"""Faces with a vertex nearer to the camera than this, in metres, are not drawn."""

_SUBPIXEL_BITS = 4


def silhouette(
    model: ObjectModel, T_cam_obj: np.ndarray, K: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """The pixels that a model covers, seen from a camera.

    Args:
        model: the object.
        T_cam_obj: its pose in the OpenCV camera frame, (4, 4), metres.
        K: camera matrix, (3, 3).
        size: height and width of the picture in pixels.

    Returns:
        uint8 (H, W), 255 where a pixel is covered and 0 elsewhere.
    """
    mask = np.zeros(size, dtype=np.uint8)
    vertices = transform(np.asarray(T_cam_obj, dtype=np.float64), model.vertices)
    triangles = vertices[model.faces]
    triangles = triangles[(triangles[..., 2] > NEAREST).all(axis=1)]
    pixels = project(triangles, np.asarray(K, dtype=np.float64))
    # Far outside, fixed-point coordinates would overflow.
    pixels = pixels[(np.abs(pixels) < 10 * max(size)).all(axis=(1, 2))]
    fixed = np.round(pixels * (1 << _SUBPIXEL_BITS)).astype(np.int32)
    for triangle in fixed:
        cv2.fillConvexPoly(mask, triangle, 255, shift=_SUBPIXEL_BITS)
    return mask


def draw_outline(
    image: np.ndarray,
    model: ObjectModel,
    T_cam_obj: np.ndarray,
    K: np.ndarray,
    colour: tuple[int, int, int] = (0, 255, 0),
    thickness: int = 2,
) -> np.ndarray:
    """A copy of ``image`` with the outline of the model at a pose.

    Args:
        image: RGB uint8, (H, W, 3).
        model: the object.
        T_cam_obj: its pose in the OpenCV camera frame, (4, 4), metres.
        K: camera matrix, (3, 3).
        colour: RGB.
        thickness: of the line, in pixels.

    Returns:
        RGB uint8, (H, W, 3).
    """
    mask = silhouette(model, T_cam_obj, K, image.shape[:2])
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    picture = np.ascontiguousarray(image).copy()
    cv2.drawContours(picture, outlines, -1, colour, thickness, cv2.LINE_AA)
    return picture
