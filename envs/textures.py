"""Procedural textures: what tables, walls and plain shapes are covered with.

Every texture is (size, size, 3) uint8; all but collages and markers tile without a seam. They are
drawn in place: an episode draws seven, and large arrays that come and go fragment the heap.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..pose_estimator.collage import draw_collage, draw_markers

PATTERNS = ("plain", "noise", "wood", "checker", "gradient", "speckle")
"""What furniture is made of."""

PRINTED = ("collage", "markers")
"""What lies on it, in colours of its own: posters and magazines, calibration boards."""


def procedural_texture(
    rng: np.random.Generator,
    size: int,
    pattern: str,
    colours: np.ndarray,
) -> np.ndarray:
    """Draws a texture.

    Args:
        rng: where its random parts come from.
        size: side in pixels.
        pattern: one of :data:`PATTERNS` or :data:`PRINTED`.
        colours: two colours in [0, 1], (2, 3); the pattern goes from one to the other. Printed
            ones have their own.

    Raises:
        ValueError: if the pattern is unknown.
    """
    if pattern == "collage":
        return draw_collage(rng, size)
    if pattern == "markers":
        return draw_markers(rng, size)
    if pattern == "plain":
        mix = fractal_noise(rng, size, 8)
        mix *= 0.12
    elif pattern == "noise":
        mix = fractal_noise(rng, size, int(rng.integers(3, 12)))
    elif pattern == "wood":
        mix = _wood(rng, size)
    elif pattern == "checker":
        cells = int(2 * rng.integers(2, 9))
        odd = np.arange(size) * cells // size % 2 == 1
        mix = fractal_noise(rng, size, 6)
        mix *= 0.1
        bright = odd[:, None] != odd[None]
        np.add(mix, 0.9, out=mix, where=bright, dtype=np.float64, casting="same_kind")
    elif pattern == "gradient":
        i = np.cos(2 * np.pi * (np.arange(size) / size + rng.uniform()))
        mix = i[:, None] * rng.uniform(-1, 1) + i[None] * rng.uniform(-1, 1)
        mix /= 4
        mix += 0.5
    elif pattern == "speckle":
        mix = fractal_noise(rng, size, 6)
        mix *= 0.3
        mix += rng.random((size, size), dtype=np.float32) > rng.uniform(0.9, 0.99)
    else:
        raise ValueError(f"pattern must be one of {PATTERNS + PRINTED}, got {pattern!r}")
    steps = np.linspace(0.0, 1.0, 256)[:, None]
    low, high = np.asarray(colours)
    ramp = np.clip(255.0 * (low + (high - low) * steps), 0, 255).astype(np.uint8)
    np.clip(mix, 0.0, 1.0, out=mix)
    levels = cv2.convertScaleAbs(mix.astype(np.float32, copy=False), alpha=255.0)
    return cv2.applyColorMap(levels, ramp[:, None, :])


def fractal_noise(rng: np.random.Generator, size: int, cells: int) -> np.ndarray:
    """Smooth noise in [0, 1] of several octaves, the coarsest of ``cells`` bumps a side.

    Each octave is added at its own resolution and the sum enlarged, which costs little more than
    the last enlargement.
    """
    total = rng.random((cells, cells), dtype=np.float32)
    weight = 0.6
    while 2 * total.shape[0] <= size // 2:
        total = _periodic(total, 2 * total.shape[0], 2 * total.shape[0])
        total += weight * rng.random(total.shape, dtype=np.float32)
        weight *= 0.6
    total = _periodic(total, size, size)
    low, high = float(total.min()), float(total.max())
    total -= low
    total /= max(high - low, 1e-6)
    return total


def _periodic(grid: np.ndarray, height: int, width: int) -> np.ndarray:
    """Enlarges a grid smoothly so that its opposite edges meet."""
    pad = 2
    wrapped = np.pad(grid, pad, mode="wrap")
    scale_y, scale_x = height / grid.shape[0], width / grid.shape[1]
    affine = np.array(
        [[scale_x, 0, (0.5 - pad) * scale_x - 0.5], [0, scale_y, (0.5 - pad) * scale_y - 0.5]]
    )
    return cv2.warpAffine(wrapped, affine, (width, height), flags=cv2.INTER_CUBIC)


def _wood(rng: np.random.Generator, size: int) -> np.ndarray:
    """Grain along x: stripes of noise, bent a little, with finer fibres."""
    grain = _periodic(rng.random((4, 4), dtype=np.float32), size, size)
    grain *= rng.uniform(0.02, 0.12)
    grain += np.arange(size, dtype=np.float32)[:, None] / size
    profile = np.interp(
        np.arange(4 * size) / (4 * size),
        np.linspace(0, 1, 65),
        np.append(values := rng.random(64), values[0]),
    ).astype(np.float32)
    for rows in np.array_split(grain, 8):
        rows[:] = profile[(rows * 4 * size).astype(np.int64) % (4 * size)]
    fibres = _periodic(rng.random((size // 4, 8), dtype=np.float32), size, size)
    grain *= 0.65
    fibres *= 0.35
    grain += fibres
    return grain
