"""Changes to training crops that a test will bring by itself: light, sensors, hidden parts."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class AugmentationConfig:
    """How far the training crops are bent.

    Attributes:
        shift: standard deviation of the crop's centre, in sides of the crop.
        scale: standard deviation of the logarithm of its side.
        turn: largest in-plane turn, radians.
        brightness: standard deviation of the logarithm of the exposure.
        contrast: standard deviation of the logarithm of the contrast.
        white_balance: standard deviation of the logarithm of each channel's gain.
        noise: largest standard deviation of the pixel noise, in levels.
        blur: probability of a slight blur.
        erase: probability that a random box hides a part of the picture.
    """

    shift: float = 0.04
    scale: float = 0.07
    turn: float = 0.25
    brightness: float = 0.15
    contrast: float = 0.12
    white_balance: float = 0.05
    noise: float = 6.0
    blur: float = 0.2
    erase: float = 0.1


def jitter_affine(
    side: int, zoom: float, config: AugmentationConfig, rng: np.random.Generator
) -> np.ndarray:
    """The map from a stored crop to a jittered training crop.

    Args:
        side: side of the training crop in pixels; the stored crop has its centre at the target.
        zoom: training pixels per stored pixel without jitter.
        config: how far to go.
        rng: source of randomness.

    Returns:
        (3, 3) affine map, around the crops' centres; the caller shifts it to pixel coordinates.
    """
    scale = zoom * np.exp(np.clip(rng.normal(0, config.scale), -0.2, 0.2))
    angle = rng.uniform(-config.turn, config.turn)
    shift = np.clip(rng.normal(0, config.shift, 2), -0.12, 0.12) * side
    cosine, sine = scale * np.cos(angle), scale * np.sin(angle)
    return np.array([[cosine, -sine, shift[0]], [sine, cosine, shift[1]], [0, 0, 1.0]])


def erase_box(
    config: AugmentationConfig,
    rng: np.random.Generator,
    picture: np.ndarray,
    mask: np.ndarray | None = None,
    depth: np.ndarray | None = None,
) -> None:
    """Sometimes hides a random box, in place.

    Args:
        config: how often.
        rng: source of randomness.
        picture: RGB uint8 (H, W, 3); the box gets one colour.
        mask: of what is visible, (H, W) uint8; nothing is within the box.
        depth: metres (H, W); unknown (0) within the box.
    """
    if rng.random() >= config.erase:
        return
    height, width = picture.shape[:2]
    h, w = (rng.uniform(0.1, 0.35, 2) * (height, width)).astype(int)
    y, x = rng.integers(0, height - h), rng.integers(0, width - w)
    box = slice(y, y + h), slice(x, x + w)
    picture[box] = rng.integers(0, 256, 3)
    for hidden in (mask, depth):
        if hidden is not None:
            hidden[box] = 0


def augment_colours(
    picture: np.ndarray, config: AugmentationConfig, rng: np.random.Generator
) -> np.ndarray:
    """Changes light and sensor of a picture, RGB uint8 (H, W, 3); returns a new one."""
    gain = np.exp(rng.normal(0, config.brightness) + rng.normal(0, config.white_balance, 3))
    contrast = np.exp(rng.normal(0, config.contrast))
    levels = np.arange(256, dtype=np.float32)[:, None]
    table = (levels - 127) * contrast + 127
    table = np.clip(table * gain, 0, 255).astype(np.uint8)
    out = cv2.LUT(picture, np.ascontiguousarray(table[:, None, :].reshape(1, 256, 3)))
    if rng.random() < config.blur:
        out = cv2.GaussianBlur(out, (0, 0), rng.uniform(0.4, 1.2))
    sigma = rng.uniform(0, config.noise)
    if sigma > 1:
        noise = np.empty(out.shape, np.int16)
        cv2.setRNGSeed(int(rng.integers(2**31)))
        cv2.randn(noise, 0, sigma)  # type: ignore[call-overload]
        out = np.clip(out + noise, 0, 255).astype(np.uint8)
    return out
