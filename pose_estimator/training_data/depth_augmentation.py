"""Augmentation of the depth of a training crop: sensor noise and holes."""

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class DepthAugmentationConfig:
    """Maximum strength of the sensor noise; each crop draws its own.

    Attributes:
        noise: factor of the Kinect's standard deviation along z.
        steps: factor of the Kinect's disparity quantization.
        window: standard deviation of the smoothing of the noise, in crop pixels.
        edges: width of the missing depth along depth edges, in crop pixels.
        holes: probability of a missing box.
        lost: fraction of missing single pixels.
    """

    noise: float = 1.5
    steps: float = 1.5
    window: float = 3.0
    edges: int = 4
    holes: float = 0.3
    lost: float = 0.3


_STEP = 0.125 / (572.4 * 0.075)
"""The Kinect's quantization of inverse depth, 1/m: an eighth of a pixel of disparity (focal length
572.4, baseline 75 mm)."""

_EDGE = 0.01
"""Relative depth difference of neighboring crop pixels that counts as an edge."""


def augment_depth(
    depth: np.ndarray, config: DepthAugmentationConfig, rng: np.random.Generator
) -> np.ndarray:
    """Adds Kinect-like noise to the depth (S, S) of a crop in meters, 0 = unknown.

    The standard deviation along z is that of Nguyen et al., "Modeling Kinect sensor noise",
    3DIMPVT 2012, for surfaces that face the camera.

    Returns:
        A new map (S, S) float32.
    """
    known = depth > 0
    z = np.maximum(depth, 0.1)
    deviation = config.noise * rng.uniform() * (0.0012 + 0.0019 * (z - 0.4) ** 2)
    noise = rng.standard_normal(depth.shape, dtype=np.float32)
    window = rng.uniform(0, config.window)
    if window > 0.3:
        kernel = cv2.getGaussianKernel(2 * int(3 * window) + 3, window, cv2.CV_32F)
        smooth = cv2.sepFilter2D(noise, -1, kernel, kernel) / float((kernel**2).sum())
        noise = smooth.astype(np.float32)
    inverse = 1 / np.maximum(z + deviation * noise, 0.1)
    step = config.steps * rng.uniform() * _STEP
    if step > 0.1 * _STEP:
        inverse = np.maximum(np.round(inverse / step), 1) * step
    lost = rng.random(depth.shape, dtype=np.float32) < config.lost * rng.uniform() ** 2
    width = int(rng.integers(config.edges + 1))
    if width:
        square = np.ones((3, 3), np.uint8)
        edge = (cv2.dilate(z, square) - cv2.erode(z, square)) > 2 * _EDGE * z
        lost |= cv2.dilate(edge.astype(np.uint8), np.ones((width, width), np.uint8)).astype(bool)
    if rng.random() < config.holes:
        h, w = (rng.uniform(0.05, 0.35, 2) * depth.shape).astype(int)
        y, x = rng.integers(0, depth.shape[0] - h), rng.integers(0, depth.shape[1] - w)
        lost[y : y + h, x : x + w] = True
    return np.where(known & ~lost, 1 / inverse, 0).astype(np.float32)
