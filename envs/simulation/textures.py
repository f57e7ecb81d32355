"""Procedural textures: what tables, walls and plain shapes are covered with.

Every texture is (size, size, 3) uint8; all but collages and markers tile without a seam. They are
drawn on canvases that are kept: an episode draws seven, and large arrays that come and go fragment
the heap.
"""

from __future__ import annotations

import threading

import cv2
import numpy as np

from ...assets.collage import draw_collage, draw_markers
from ...core.errors import InputError

PATTERNS = ("plain", "noise", "wood", "checker", "gradient", "speckle")
"""What furniture is made of."""

PRINTED = ("collage", "markers")
"""What lies on it, in colors of its own: posters and magazines, calibration boards."""

_STRIPS = 32
"""In which what needs double precision is drawn."""


def procedural_texture(
    rng: np.random.Generator,
    size: int,
    pattern: str,
    colors: np.ndarray,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Draws a texture.

    Args:
        rng: where its random parts come from.
        size: side in pixels.
        pattern: one of :data:`PATTERNS` or :data:`PRINTED`.
        colors: two colors in [0, 1], (2, 3); the pattern goes from one to the other. Printed
            ones have their own.
        out: where it is drawn, (size, size, 3) uint8; a new array if None.

    Raises:
        InputError: if the pattern is unknown.
    """
    image = np.empty((size, size, 3), np.uint8) if out is None else out
    if pattern in PRINTED:
        image[:] = draw_collage(rng, size) if pattern == "collage" else draw_markers(rng, size)
        return image
    mix = _canvas((size, size))
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
        bright = np.not_equal(odd[:, None], odd[None], out=_canvas((size, size), 0, np.bool_))
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
        chance = rng.random(out=_canvas((size, size), 1), dtype=np.float32)
        rare = rng.uniform(0.9, 0.99)
        mix += np.greater(chance, rare, out=_canvas((size, size), 0, np.bool_))
    else:
        raise InputError(f"pattern must be one of {PATTERNS + PRINTED}, got {pattern!r}")
    steps = np.linspace(0.0, 1.0, 256)[:, None]
    low, high = np.asarray(colors)
    ramp = np.clip(255.0 * (low + (high - low) * steps), 0, 255).astype(np.uint8)
    np.clip(mix, 0.0, 1.0, out=mix)
    levels = cv2.convertScaleAbs(mix, dst=_canvas((size, size), 0, np.uint8), alpha=255.0)
    return cv2.applyColorMap(levels, ramp[:, None, :], dst=image)


def fractal_noise(rng: np.random.Generator, cells: int, out: np.ndarray) -> None:
    """Draws smooth noise in [0, 1] of several octaves, the coarsest of ``cells`` bumps a side.

    Each octave is added at its own resolution and the sum enlarged, which costs little more than
    the last enlargement.

    Args:
        rng: where it comes from.
        cells: bumps a side.
        out: where it is drawn, (size, size) float32.
    """
    total = rng.random((cells, cells), dtype=np.float32)
    weight = 0.6
    while 2 * total.shape[0] <= len(out) // 2:
        larger = 2 * total.shape[0], 2 * total.shape[1]
        total = _enlarge(total, _canvas(larger))
        finer = rng.random(out=_canvas(larger, 1), dtype=np.float32)
        finer *= weight
        total += finer
        weight *= 0.6
    _enlarge(total, out)
    low, high = float(out.min()), float(out.max())
    out -= low
    out /= max(high - low, 1e-6)


_canvases = threading.local()


def _canvas(shape: tuple[int, int], number: int = 0, dtype: type = np.float32) -> np.ndarray:
    """An array of this thread, which the next drawing draws over."""
    name = f"{shape} {number} {dtype.__name__}"
    if not hasattr(_canvases, name):
        setattr(_canvases, name, np.empty(shape, dtype))
    return getattr(_canvases, name)


def _enlarge(grid: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Enlarges a grid smoothly so that its opposite edges meet."""
    pad = 2
    wrapped = cv2.copyMakeBorder(
        grid,
        *(pad,) * 4,
        cv2.BORDER_WRAP,
        dst=_canvas((grid.shape[0] + 2 * pad, grid.shape[1] + 2 * pad), 2),  # never grid or out
    )
    height, width = out.shape
    scale_y, scale_x = height / grid.shape[0], width / grid.shape[1]
    affine = np.array(
        [[scale_x, 0, (0.5 - pad) * scale_x - 0.5], [0, scale_y, (0.5 - pad) * scale_y - 0.5]]
    )
    return cv2.warpAffine(wrapped, affine, (width, height), dst=out, flags=cv2.INTER_CUBIC)


def _draw_wood(rng: np.random.Generator, out: np.ndarray) -> None:
    """Grain along x: stripes of noise, bent a little, with finer fibres."""
    size = len(out)
    _enlarge(rng.random((4, 4), dtype=np.float32), out)
    out *= rng.uniform(0.02, 0.12)
    out += np.arange(size, dtype=np.float32)[:, None] / size
    profile = np.interp(
        np.arange(4 * size) / (4 * size),
        np.linspace(0, 1, 65),
        np.append(values := rng.random(64), values[0]),
    ).astype(np.float32)
    for rows in np.array_split(out, _STRIPS):
        rows[:] = profile[(rows * 4 * size).astype(np.int64) % (4 * size)]
    fibres = _enlarge(rng.random((size // 4, 8), dtype=np.float32), _canvas((size, size), 1))
    out *= 0.65
    fibres *= 0.35
    out += fibres
