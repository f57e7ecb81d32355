"""A light detector of all objects in a full frame.

A center heat map and a ROI size for each object (Zhou et al., "Objects as Points", 2019), at stride
8 of an image scaled to 320x240. The "center" is the projection of the object's origin, also where
it is occluded, so that two detections triangulate to the object.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..types import Roi
from .decoder import ConvBlock
from .encoder import Encoder

_MAX_PEAKS = 10
"""Maximum number of detections of one object."""

_MIN_PEAK_SCORE = 0.003
"""Minimum score of a peak other than the best."""


@dataclass(frozen=True)
class DetectorConfig:
    """Shape of the detector.

    Attributes:
        height: rows of its input.
        width: columns of its input.
        stride: input pixels per pixel of the heat map.
        channels: width of its neck.
        roi_scale: side of the region of interest in object diameters.
    """

    height: int = 240
    width: int = 320
    stride: int = 8
    channels: int = 64
    roi_scale: float = 1.4


class Detector(nn.Module):
    """Center heat maps and sizes of ``objects`` objects."""

    def __init__(self, objects: int, config: DetectorConfig = DetectorConfig()):
        super().__init__()
        self.config = config
        self.objects = objects
        self.encoder = Encoder(5)
        _, c8, c16 = self.encoder.channels
        width = config.channels
        self.neck = ConvBlock(c16, width)
        self.context = nn.Sequential(ConvBlock(width, width), ConvBlock(width, width))
        self.merge = ConvBlock(width + c8, width)
        self.head = nn.Conv2d(width, 4 * objects, 1)
        assert self.head.bias is not None
        with torch.no_grad():
            self.head.bias.zero_()
            self.head.bias[:objects] = -4.0

    def forward(self, frames: Tensor) -> tuple[Tensor, Tensor]:
        """Detects in frames.

        Args:
            frames: (B, 3, 240, 320), RGB in 0..255 as floats.

        Returns:
            Heat map logits (B, N, 30, 40), and (B, N, 3, 30, 40): the offset of the center from the
            cell in cells (x, y) and the logarithm of the region's side in input pixels over 32.
        """
        # Pads rows to a multiple of 16 for the encoder, and crops them again.
        rows = frames.shape[2] // self.config.stride
        _, f8, f16 = self.encoder(F.pad(frames, (0, 0, 0, -frames.shape[2] % 16)))
        x = self.neck(f16)
        x = x + self.context(x)
        x = F.interpolate(x, size=f8.shape[2:], mode="bilinear", align_corners=False)
        x = self.head(self.merge(torch.cat([x, f8], 1)))[:, :, :rows]
        batch, _, height, width = x.shape
        return x[:, : self.objects], x[:, self.objects :].reshape(
            batch, self.objects, 3, height, width
        )


def detector_input(image: np.ndarray, config: DetectorConfig) -> tuple[np.ndarray, np.ndarray]:
    """Scales an RGB image (H, W, 3) uint8 to the detector's input, keeping its aspect ratio.

    Returns:
        The input, uint8 (240, 320, 3), and the affine map (3, 3) from its pixels to the image's.
    """
    height, width = image.shape[:2]
    scale = max(width / config.width, height / config.height)
    inner = (max(1, round(width / scale)), max(1, round(height / scale)))
    small = cv2.resize(image, inner, interpolation=cv2.INTER_AREA)
    if inner != (config.width, config.height):
        below, right = config.height - inner[1], config.width - inner[0]
        small = cv2.copyMakeBorder(
            small, 0, below, 0, right, cv2.BORDER_CONSTANT, value=(127, 127, 127)
        )
    sx, sy = width / inner[0], height / inner[1]
    to_image = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1.0]])
    return np.ascontiguousarray(small), to_image


def decode(
    logits: np.ndarray, regression: np.ndarray, to_image: np.ndarray, config: DetectorConfig
) -> Roi:
    """Decodes the best detection of one object.

    Args:
        logits: (30, 40) heat map logits of the object.
        regression: (3, 30, 40), see :meth:`Detector.forward`.
        to_image: (3, 3), from the detector's input to the image.
        config: the detector's.

    Returns:
        The region of interest in the image. Its score is the heat map's value, in 0 to 1.
    """
    row, column = (int(i) for i in np.unravel_index(int(np.argmax(logits)), logits.shape))
    return _roi_at(row, column, logits, regression, to_image, config)


def decode_peaks(
    logits: np.ndarray, regression: np.ndarray, to_image: np.ndarray, config: DetectorConfig
) -> list[Roi]:
    """Decodes the peaks of the heat map by falling score; the first is :func:`decode`'s."""
    around = cv2.dilate(logits, np.ones((5, 5), np.uint8))
    rows, columns = np.nonzero(logits >= around)
    order = np.argsort(-logits[rows, columns], kind="stable")[:_MAX_PEAKS]
    found = [
        _roi_at(int(rows[i]), int(columns[i]), logits, regression, to_image, config) for i in order
    ]
    return [found[0], *(roi for roi in found[1:] if roi.score >= _MIN_PEAK_SCORE)]


def _roi_at(
    row: int,
    column: int,
    logits: np.ndarray,
    regression: np.ndarray,
    to_image: np.ndarray,
    config: DetectorConfig,
) -> Roi:
    """The region of interest of one cell of the heat map."""
    dx, dy, log_side = regression[:, row, column]
    cell = np.array([column + dx, row + dy]) * config.stride + (config.stride - 1) / 2
    scale = to_image[0, 0]
    side = float(32.0 * np.exp(np.clip(log_side, -3.0, 3.0)) * scale)
    confidence = float(1.0 / (1.0 + np.exp(-logits[row, column])))
    center = cell * [to_image[0, 0], to_image[1, 1]] + to_image[:2, 2]
    return Roi(center=center, side=side, score=confidence)


def detection_targets(
    centers: np.ndarray, sides: np.ndarray, present: np.ndarray, config: DetectorConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The detector's training targets for one image.

    Args:
        centers: (N, 2) center of each object in input pixels.
        sides: (N,) side of its region in input pixels.
        present: (N,) bool, whether the object is visible.

    Returns:
        heat (N, 30, 40) float32, regression (N, 3, 30, 40) float32, and the weight (N, 30, 40) of
        the regression, non-zero around each center.
    """
    height, width = config.height // config.stride, config.width // config.stride
    heat = np.zeros((len(centers), height, width), np.float32)
    regression = np.zeros((len(centers), 3, height, width), np.float32)
    weight = np.zeros_like(heat)
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    for index in np.flatnonzero(present):
        cell = (centers[index] - (config.stride - 1) / 2) / config.stride
        sigma = max(0.7, sides[index] / config.stride / 10)
        bump = np.exp(-((columns - cell[0]) ** 2 + (rows - cell[1]) ** 2) / (2 * sigma**2))
        nearest = np.clip(np.round(cell).astype(int), 0, (width - 1, height - 1))
        if np.abs(nearest - cell).max() <= 2:
            bump[nearest[1], nearest[0]] = 1.0
        heat[index] = bump
        regression[index, 0] = cell[0] - columns
        regression[index, 1] = cell[1] - rows
        regression[index, 2] = np.log(sides[index] / 32.0)
        weight[index] = (bump > 0.4).astype(np.float32)
    return heat, regression, weight
