"""Camera sensor model: exposure, white balance, blur, noise, compression."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ...core.geometry import check_image
from ...core.validation import require_range, require_within

_NOISE_STRIP = 1 << 15


@dataclass(frozen=True)
class SensorConfig:
    """Ranges of image degradations; each strength is sampled per image.

    Attributes:
        exposure: maximum change of brightness, as a fraction.
        white_balance: maximum change of the red and of the blue channel, as a fraction.
        gamma: maximum change of the exponent, as a fraction.
        blur: maximum standard deviation of the Gaussian blur, pixels.
        noise: maximum standard deviation of the noise, gray levels.
        jpeg_probability: of compression.
        jpeg_quality: minimum and maximum JPEG quality, 1 to 100.
    """

    exposure: float = 0.15
    white_balance: float = 0.06
    gamma: float = 0.1
    blur: float = 0.8
    noise: float = 6.0
    jpeg_probability: float = 0.3
    jpeg_quality: tuple[int, int] = (55, 95)

    def __post_init__(self) -> None:
        require_within(self, 0, 1, "exposure", "white_balance", "gamma", "jpeg_probability")
        require_within(self, 0, np.inf, "blur", "noise")
        require_range(self, 1, 100, "jpeg_quality")

    @classmethod
    def none(cls) -> SensorConfig:
        """Returns a perfect sensor, which leaves images unchanged."""
        return cls(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class SensorState:
    """The sampled sensor parameters of one camera.

    Attributes:
        white: gray level of white in each channel, (3,).
        gamma: exponent of the tone curve.
        blur: standard deviation of the Gaussian blur, pixels.
        noise: standard deviation of the noise, gray levels.
        jpeg_quality: 1 to 100; None for no compression.
    """

    white: np.ndarray
    gamma: float
    blur: float
    noise: float
    jpeg_quality: int | None

    @classmethod
    def sample(cls, config: SensorConfig, rng: np.random.Generator) -> SensorState:
        """Samples a camera within the ranges of ``config``."""
        gain = 1.0 + rng.uniform(-config.exposure, config.exposure)
        balance = 1.0 + config.white_balance * rng.uniform(-1.0, 1.0, 3) * (1.0, 0.0, 1.0)
        gamma = 1.0 + rng.uniform(-config.gamma, config.gamma)
        blur = config.blur * rng.uniform()
        noise = config.noise * rng.uniform()
        quality = int(rng.integers(config.jpeg_quality[0], config.jpeg_quality[1] + 1))
        compressed = rng.uniform() < config.jpeg_probability
        return cls(255.0 * gain * balance, gamma, blur, noise, quality if compressed else None)

    def resample_blur(self, config: SensorConfig, rng: np.random.Generator) -> SensorState:
        """Returns the same camera with a newly sampled blur."""
        return replace(self, blur=config.blur * rng.uniform())

    def apply(self, rgb: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Returns a degraded copy of an image (H, W, 3) uint8; an InputError if it is not RGB."""
        image = check_image(rgb, "rgb")
        levels = np.linspace(0.0, 1.0, 256)[:, None] ** self.gamma * self.white
        out = cv2.LUT(image, np.clip(np.round(levels), 0, 255).astype(np.uint8)[:, None, :])
        if self.blur > 0.2:
            out = cv2.GaussianBlur(out, (0, 0), self.blur)
        if self.noise > 0.3:
            out = _add_noise(out, self.noise, rng)
        if self.jpeg_quality is not None:
            bgr = cv2.cvtColor(out, cv2.COLOR_RGB2BGR)
            _, code = cv2.imencode(".jpg", bgr, (cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality))
            decoded = cv2.imdecode(code, cv2.IMREAD_COLOR)
            assert decoded is not None
            out = cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB)
        return out


def apply_sensor(rgb: np.ndarray, config: SensorConfig, rng: np.random.Generator) -> np.ndarray:
    """:meth:`SensorState.apply` with newly sampled parameters."""
    return SensorState.sample(config, rng).apply(rgb, rng)


def _add_noise(image: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Adds Gaussian noise; rows are random windows of one strip, cheaper than sampling all."""
    height, width, channels = image.shape
    row = width * channels
    strip = rng.standard_normal(_NOISE_STRIP + row, dtype=np.float32)
    strip = np.rint(strip * np.float32(sigma)).astype(np.int16)
    starts = rng.integers(_NOISE_STRIP, size=height)
    noise = np.lib.stride_tricks.sliding_window_view(strip, row)[starts]
    return cv2.add(image, noise.reshape(image.shape), dtype=cv2.CV_8U)
