"""Affine maps of images, and square crops cut out by them."""

import cv2
import numpy as np


def similarity_matrix(
    scale: float, angle: float, target: np.ndarray, source: np.ndarray
) -> np.ndarray:
    """Returns the affine map (3, 3) that scales, rotates, and moves ``source`` to ``target``.

    Args:
        scale: factor.
        angle: radians.
        target: (2,) pixels.
        source: (2,) pixels.
    """
    cosine, sine = scale * np.cos(angle), scale * np.sin(angle)
    matrix = np.array([[cosine, -sine, target[0]], [sine, cosine, target[1]], [0, 0, 1.0]])
    matrix[:2, 2] -= matrix[:2, :2] @ source
    return matrix


def warp_crop(image: np.ndarray, affine: np.ndarray, side: int) -> np.ndarray:
    """Cuts a crop by an affine map, averaging where it shrinks.

    Args:
        image: (H, W) or (H, W, 3) uint8.
        affine: (3, 3) from pixels of the image to pixels of the crop.
        side: side of the crop.

    Returns:
        (side, side) or (side, side, 3) uint8; outside the image gray (127), or 0 in masks.
    """
    shrink = 1.0 / np.sqrt(abs(np.linalg.det(affine[:2, :2])))
    matrix = affine[:2]
    if shrink > 1.5:
        # Bilinear sampling alone would alias: shrink the region first.
        factor = 1.0 / round(shrink)
        corners = np.linalg.inv(affine) @ np.array(
            [[0, side, 0, side], [0, 0, side, side], [1, 1, 1, 1.0]]
        )
        low = np.clip(np.floor(corners[:2].min(1)) - 2, 0, None).astype(int)
        high = np.ceil(corners[:2].max(1)).astype(int) + 3
        region = image[low[1] : max(high[1], low[1] + 1), low[0] : max(high[0], low[0] + 1)]
        if region.size:
            width = max(1, round(region.shape[1] * factor))
            height = max(1, round(region.shape[0] * factor))
            fx, fy = width / region.shape[1], height / region.shape[0]
            image = cv2.resize(region, (width, height), interpolation=cv2.INTER_AREA)
            shift = [(1 / fx - 1) / 2 + low[0], (1 / fy - 1) / 2 + low[1]]
            back = np.array([[1 / fx, 0, shift[0]], [0, 1 / fy, shift[1]], [0, 0, 1.0]])
            matrix = (affine @ back)[:2]
    border = (127, 127, 127) if image.ndim == 3 else 0
    return cv2.warpAffine(image, matrix, (side, side), flags=cv2.INTER_LINEAR, borderValue=border)
