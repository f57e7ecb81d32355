"""Augmentation of training images: geometry, light, sensor noise, occlusion.

Images are RGB uint8 (H, W, 3), masks uint8 (H, W) from 0 to 255.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...core.image_crop import similarity_matrix
from .cut_and_paste import blend


@dataclass(frozen=True)
class AugmentationConfig:
    """Augmentation strength. The fields from ``saturation`` on are off unless :meth:`strong`.

    Attributes:
        shift: standard deviation of the crop's center, in sides of the crop.
        scale: standard deviation of the logarithm of its side.
        rotation: maximum in-plane rotation of a crop, radians.
        frame_rotation: the same of a full frame for the detector.
        frame_scale: maximum absolute logarithm of a full frame's scale.
        brightness: standard deviation of the logarithm of the exposure.
        contrast: standard deviation of the logarithm of the contrast.
        white_balance: standard deviation of the logarithm of each channel's gain.
        noise: maximum standard deviation of the pixel noise, in levels.
        blur: probability of a slight blur.
        erase: probability that a random box hides a part of the image.
        saturation: standard deviation of the logarithm of the saturation factor.
        shading: probability of an illumination gradient.
        motion_blur: probability of motion blur.
        sharpen: probability of sharpening, as webcams do it.
        low_resolution: probability of downsampling and enlarging.
        spots: probability of spots on the target: highlights, dirt.
        recolored_side: probability that one side of the target has another color, such as an
            opening that its scan closes.
    """

    shift: float = 0.04
    scale: float = 0.07
    rotation: float = 0.25
    frame_rotation: float = 0.15
    frame_scale: float = 0.15
    brightness: float = 0.15
    contrast: float = 0.12
    white_balance: float = 0.05
    noise: float = 6.0
    blur: float = 0.2
    erase: float = 0.1
    saturation: float = 0.0
    shading: float = 0.0
    motion_blur: float = 0.0
    sharpen: float = 0.0
    low_resolution: float = 0.0
    spots: float = 0.0
    recolored_side: float = 0.0

    @classmethod
    def strong(cls) -> AugmentationConfig:
        """For real images: varied light, webcams, jittered ROIs."""
        return cls(
            shift=0.09,
            scale=0.1,
            rotation=0.5,
            frame_rotation=0.3,
            frame_scale=0.3,
            brightness=0.22,
            contrast=0.2,
            white_balance=0.08,
            noise=12.0,
            blur=0.35,
            erase=0.25,
            saturation=0.3,
            shading=0.4,
            motion_blur=0.15,
            sharpen=0.3,
            low_resolution=0.2,
            spots=0.4,
            recolored_side=0.2,
        )


def jitter_affine(
    side: int, zoom: float, config: AugmentationConfig, rng: np.random.Generator
) -> np.ndarray:
    """Returns a random affine map (3, 3) about the crops' centers.

    Args:
        side: side of the training crop in pixels.
        zoom: training pixels per stored pixel without jitter.
        config: augmentation strength.
        rng: random generator.
    """
    scale = zoom * np.exp(np.clip(rng.normal(0, config.scale), -0.25, 0.25))
    angle = rng.uniform(-config.rotation, config.rotation)
    shift = np.clip(rng.normal(0, 1, 2), -3, 3) * config.shift * side
    return similarity_matrix(scale, angle, shift, np.zeros(2))


def jitter_frame(
    size: tuple[int, int], config: AugmentationConfig, rng: np.random.Generator
) -> np.ndarray:
    """Returns a random similarity (3, 3) about the middle of a (width, height) frame."""
    scale = np.exp(rng.uniform(-config.frame_scale, config.frame_scale))
    angle = rng.uniform(-config.frame_rotation, config.frame_rotation)
    middle = (np.array(size) - 1) / 2
    return similarity_matrix(scale, angle, middle + rng.uniform(-0.06, 0.06, 2) * size, middle)


def erase_box(
    config: AugmentationConfig,
    rng: np.random.Generator,
    image: np.ndarray,
    mask: np.ndarray | None = None,
    depth: np.ndarray | None = None,
) -> None:
    """Erases a random box with the configured probability, in place.

    The image gets one color within the box, the visible mask and the depth (H, W) 0.
    """
    if not _happens(config.erase, rng):
        return
    height, width = image.shape[:2]
    h, w = (rng.uniform(0.1, 0.35, 2) * (height, width)).astype(int)
    y, x = rng.integers(0, height - h), rng.integers(0, width - w)
    box = slice(y, y + h), slice(x, x + w)
    image[box] = rng.integers(0, 256, 3)
    for hidden in (mask, depth):
        if hidden is not None:
            hidden[box] = 0


def paint_spots(
    config: AugmentationConfig, rng: np.random.Generator, image: np.ndarray, mask: np.ndarray
) -> np.ndarray:
    """Paints soft spots of random brightness on the target with the configured probability.

    A scanned model differs from its object. Returns a new image, or ``image`` itself if nothing is
    painted; the target's visible mask is unchanged.
    """
    if not _happens(config.spots, rng):
        return image
    rows, columns = np.nonzero(mask > 127)
    if not len(rows):
        return image
    side = len(mask)
    for _ in range(int(rng.integers(1, 4))):
        place = rng.integers(len(rows))
        spot: np.ndarray = np.zeros(mask.shape, np.uint8)
        axes = (side * rng.uniform(0.04, 0.2) * np.array([1.0, rng.uniform(0.3, 1.0)])).tolist()
        center = (float(columns[place]), float(rows[place]))
        cv2.ellipse(spot, (center, axes, float(rng.uniform(0, 180))), 255, -1)
        spot = cv2.GaussianBlur(spot, (0, 0), rng.uniform(0.5, 3.0))
        image = _tint(image, np.minimum(spot, mask), rng)
    return image


def recolor_side(
    config: AugmentationConfig,
    rng: np.random.Generator,
    image: np.ndarray,
    mask: np.ndarray,
    points: np.ndarray,
    pixels: np.ndarray,
    view: np.ndarray,
) -> np.ndarray:
    """Recolors a visible side of the target with the configured probability.

    LineMOD's can is open and dark at the top; its scan is closed. Returns a new image, or ``image``
    itself if nothing is recolored.

    Args:
        config: augmentation strength.
        rng: random generator.
        image: of the target.
        mask: of the visible target.
        points: (P, 3) of its surface, in its frame.
        pixels: (P, 2) their projections.
        view: (3,) from the target towards the camera, in its frame.
    """
    if not len(points) or not _happens(config.recolored_side, rng):
        return image
    normal = np.eye(3)[rng.integers(3)] if rng.random() < 0.7 else rng.normal(size=3)
    heights = points @ (normal * (1.0 if normal @ view > 0 else -1.0))
    extent = rng.uniform(0.03, 0.35) * np.ptp(heights)
    outline = cv2.convexHull(pixels[heights >= heights.max() - extent].astype(np.float32))
    spot: np.ndarray = np.zeros(mask.shape, np.uint8)
    cv2.fillConvexPoly(spot, np.rint(outline).astype(np.int32), 255)
    spot = cv2.GaussianBlur(spot, (0, 0), rng.uniform(0.5, 2.0))
    return _tint(image, np.minimum(spot, mask), rng)


def _tint(image: np.ndarray, spot: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Blends a random color into a spot (H, W), 0 to 255, with a random opacity."""
    alpha = (spot * rng.uniform(0.3, 1.0)).astype(np.uint8)
    tint = np.clip(rng.uniform(0, 255) * rng.uniform(0.85, 1.15, 3), 0, 255)
    return blend(image, np.full_like(image, tint.astype(np.uint8)), alpha)


def augment_colors(
    image: np.ndarray, config: AugmentationConfig, rng: np.random.Generator
) -> np.ndarray:
    """Returns an image with random light, blur and sensor noise."""
    gain = np.exp(rng.normal(0, config.brightness) + rng.normal(0, config.white_balance, 3))
    contrast = np.exp(rng.normal(0, config.contrast))
    levels = np.arange(256, dtype=np.float32)[:, None]
    table = (levels - 127) * contrast + 127
    table = np.clip(table * gain, 0, 255).astype(np.uint8)
    out = cv2.LUT(image, np.ascontiguousarray(table[:, None, :].reshape(1, 256, 3)))
    if config.saturation:
        out = _saturate(out, float(np.exp(rng.normal(0, config.saturation))))
    if _happens(config.shading, rng):
        out = _illumination_gradient(out, rng)
    if _happens(config.low_resolution, rng):
        factor = rng.uniform(0.35, 0.8)
        small = cv2.resize(out, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        out = cv2.resize(small, out.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    if _happens(config.blur, rng):
        out = cv2.GaussianBlur(out, (0, 0), rng.uniform(0.4, 1.2))
    if _happens(config.motion_blur, rng):
        out = cv2.filter2D(out, -1, _motion_kernel(rng))
    if _happens(config.sharpen, rng):
        smooth = cv2.GaussianBlur(out, (0, 0), rng.uniform(0.8, 2.0))
        strength = rng.uniform(0.3, 1.5)
        out = cv2.addWeighted(out, 1 + strength, smooth, -strength, 0)
    sigma = rng.uniform(0, config.noise)
    if sigma > 1:
        noise = np.empty(out.shape, np.int16)
        cv2.setRNGSeed(int(rng.integers(2**31)))
        cv2.randn(noise, 0, sigma)  # type: ignore[call-overload]
        out = np.clip(out + noise, 0, 255).astype(np.uint8)
    return out


def _happens(probability: float, rng: np.random.Generator) -> bool:
    """A Bernoulli draw; none if the probability is 0, so that later draws do not change."""
    return probability > 0 and rng.random() < probability


def _saturate(image: np.ndarray, strength: float) -> np.ndarray:
    """Scales the saturation by ``strength``."""
    gray = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    return cv2.addWeighted(image, strength, gray, 1 - strength, 0)


def _illumination_gradient(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Applies light that varies over the image: smoothly, or also at a shadow's edge."""
    height, width = image.shape[:2]
    light = rng.uniform(0.5, 1.2, (int(rng.integers(2, 5)), int(rng.integers(2, 5))))
    smooth = cv2.resize(light.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    if rng.random() < 0.4:
        angle, middle = rng.uniform(0, 2 * np.pi), rng.uniform(-0.3, 0.3)
        x, y = np.linspace(-0.5, 0.5, width), np.linspace(-0.5, 0.5, height)
        side = np.cos(angle) * x[None] + np.sin(angle) * y[:, None] > middle
        smooth = smooth * np.where(side, rng.uniform(0.4, 0.9), 1.0).astype(np.float32)
    return cv2.multiply(image, cv2.merge([smooth] * 3), dtype=cv2.CV_8U)


def _motion_kernel(rng: np.random.Generator) -> np.ndarray:
    """A random motion blur kernel, 3 to 7 pixels long."""
    side = int(rng.choice([3, 5, 7]))
    kernel = np.zeros((side, side), np.float32)
    angle = rng.uniform(0, np.pi)
    reach = (side - 1) / 2 * np.array([np.cos(angle), np.sin(angle)])
    start, end = (np.rint((side - 1) / 2 + s * reach).astype(int).tolist() for s in (-1, 1))
    cv2.line(kernel, start, end, 1.0)
    return kernel / kernel.sum()
