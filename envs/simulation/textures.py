"""Procedural textures of tables, walls and plain shapes.

Every texture is (size, size, 3) uint8; all but collages and markers tile seamlessly. Scratch
buffers are reused: an episode draws seven textures, and large temporary arrays fragment the heap.
"""

import threading

import cv2
import numpy as np

from ...assets.collage import draw_collage, draw_markers
from ...core.errors import InputError

PATTERNS = ("plain", "noise", "wood", "checker", "gradient", "speckle")
"""Patterns of furniture."""

PRINTED = ("collage", "markers")
"""Patterns with colors of their own: posters and magazines, calibration boards."""

_STRIPS = 32
"""Number of strips in which double-precision parts are drawn, to limit memory."""


def procedural_texture(
    rng: np.random.Generator,
    size: int,
    pattern: str,
    colors: np.ndarray,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Draws a texture.

    Args:
        rng: source of randomness.
        size: side in pixels.
        pattern: one of :data:`PATTERNS` or :data:`PRINTED`.
        colors: two colors in [0, 1], (2, 3), between which the pattern interpolates; unused by
            printed patterns.
        out: output array, (size, size, 3) uint8; a new one if None.

    Raises:
        InputError: if the pattern is unknown.
    """
    image = np.empty((size, size, 3), np.uint8) if out is None else out
    if pattern in PRINTED:
        image[:] = draw_collage(rng, size) if pattern == "collage" else draw_markers(rng, size)
        return image
    mix = _scratch((size, size))
    if pattern == "plain":
        fractal_noise(rng, 8, mix)
        mix *= 0.12
    elif pattern == "noise":
        fractal_noise(rng, int(rng.integers(3, 12)), mix)
    elif pattern == "wood":
        _draw_wood(rng, mix)
    elif pattern == "checker":
        cells = int(2 * rng.integers(2, 9))
        odd = np.arange(size) * cells // size % 2 == 1
        fractal_noise(rng, 6, mix)
        mix *= 0.1
        bright = np.not_equal(odd[:, None], odd[None], out=_scratch((size, size), 0, np.bool_))
        np.add(mix, 0.9, out=mix, where=bright, dtype=np.float64, casting="same_kind")
    elif pattern == "gradient":
        i = np.cos(2 * np.pi * (np.arange(size) / size + rng.uniform()))
        down, across = i[:, None] * rng.uniform(-1, 1), i[None] * rng.uniform(-1, 1)
        for rows, part in zip(
            np.array_split(mix, _STRIPS), np.array_split(down, _STRIPS), strict=True
        ):
            rows[:] = (part + across) / 4 + 0.5
    elif pattern == "speckle":
        fractal_noise(rng, 6, mix)
        mix *= 0.3
        chance = rng.random(out=_scratch((size, size), 1), dtype=np.float32)
        rare = rng.uniform(0.9, 0.99)
        mix += np.greater(chance, rare, out=_scratch((size, size), 0, np.bool_))
    else:
        raise InputError(f"pattern must be one of {PATTERNS + PRINTED}, got {pattern!r}")
    steps = np.linspace(0.0, 1.0, 256)[:, None]
    low, high = np.asarray(colors)
    ramp = np.clip(255.0 * (low + (high - low) * steps), 0, 255).astype(np.uint8)
    np.clip(mix, 0.0, 1.0, out=mix)
    levels = cv2.convertScaleAbs(mix, dst=_scratch((size, size), 0, np.uint8), alpha=255.0)
    return cv2.applyColorMap(levels, ramp[:, None, :], dst=image)


def fractal_noise(rng: np.random.Generator, cells: int, out: np.ndarray) -> None:
    """Draws smooth noise in [0, 1] into ``out`` (size, size) float32.

    It has several octaves, the coarsest with ``cells`` cells a side. Each octave is added at its
    own resolution and the sum upsampled, which costs little more than the last upsampling.
    """
    total = rng.random((cells, cells), dtype=np.float32)
    weight = 0.6
    while 2 * total.shape[0] <= len(out) // 2:
        larger = 2 * total.shape[0], 2 * total.shape[1]
        total = _upsample(total, _scratch(larger))
        finer = rng.random(out=_scratch(larger, 1), dtype=np.float32)
        finer *= weight
        total += finer
        weight *= 0.6
    _upsample(total, out)
    low, high = float(out.min()), float(out.max())
    out -= low
    out /= max(high - low, 1e-6)


_buffers = threading.local()


def _scratch(shape: tuple[int, int], number: int = 0, dtype: type = np.float32) -> np.ndarray:
    """Returns a scratch buffer of this thread, which later calls overwrite."""
    name = f"{shape} {number} {dtype.__name__}"
    if not hasattr(_buffers, name):
        setattr(_buffers, name, np.empty(shape, dtype))
    return getattr(_buffers, name)


def _upsample(grid: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Upsamples a grid with cubic interpolation and periodic boundaries."""
    pad = 2
    wrapped = cv2.copyMakeBorder(
        grid,
        *(pad,) * 4,
        cv2.BORDER_WRAP,
        dst=_scratch((grid.shape[0] + 2 * pad, grid.shape[1] + 2 * pad), 2),  # never grid or out
    )
    height, width = out.shape
    scale_y, scale_x = height / grid.shape[0], width / grid.shape[1]
    affine = np.array(
        [[scale_x, 0, (0.5 - pad) * scale_x - 0.5], [0, scale_y, (0.5 - pad) * scale_y - 0.5]]
    )
    return cv2.warpAffine(wrapped, affine, (width, height), dst=out, flags=cv2.INTER_CUBIC)


def _draw_wood(rng: np.random.Generator, out: np.ndarray) -> None:
    """Draws grain along x: warped stripes of noise with finer fibers."""
    size = len(out)
    _upsample(rng.random((4, 4), dtype=np.float32), out)
    out *= rng.uniform(0.02, 0.12)
    out += np.arange(size, dtype=np.float32)[:, None] / size
    profile = np.interp(
        np.arange(4 * size) / (4 * size),
        np.linspace(0, 1, 65),
        np.append(values := rng.random(64), values[0]),
    ).astype(np.float32)
    for rows in np.array_split(out, _STRIPS):
        rows[:] = profile[(rows * 4 * size).astype(np.int64) % (4 * size)]
    fibers = _upsample(rng.random((size // 4, 8), dtype=np.float32), _scratch((size, size), 1))
    out *= 0.65
    fibers *= 0.35
    out += fibers
