"""Synthetic background images: collages full of edges and colors, and boards of markers.

Overlapping leaves of all sizes have the edge statistics of photographs ("dead leaves": Lee, Mumford
and Huang, IJCV 2001; Baradad et al., "Learning to See by Looking at Noise", NeurIPS 2021), so
training needs no photographs.
"""

import colorsys
from collections.abc import Sequence

import cv2
import numpy as np

_LETTERS = np.array(list("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"))


def draw_collage(rng: np.random.Generator, size: int) -> np.ndarray:
    """Draws overlapping leaves, lines and letters on clouds, (size, size, 3) uint8 RGB."""
    palette = [_color(rng) for _ in range(int(rng.integers(3, 9)))]
    image = _clouds(rng, size, palette)
    # Radii with a density of r^-2: fewer small leaves than in Lee et al. (r^-3), since a crop shows
    # the larger parts of a background.
    smallest, largest = size / 50, size / rng.uniform(2.0, 6.0)
    shares = rng.uniform(size=int(np.exp(rng.uniform(np.log(30), np.log(400)))))
    radii = 1 / ((1 - shares) / smallest + shares / largest)
    for radius in radii if rng.uniform() < 0.5 else np.sort(radii)[::-1]:
        free = rng.uniform() < 0.15
        color = _color(rng) if free else palette[rng.integers(len(palette))]
        draw_leaf(image, rng, float(radius), color, rng.uniform(0, size, 2))
    for _ in range(int(rng.integers(0, 4))):
        _draw_text(image, rng, palette[rng.integers(len(palette))])
    light = cv2.resize(
        rng.uniform(0.55, 1.15, (3, 3)).astype(np.float32), (size, size),
        interpolation=cv2.INTER_LINEAR,
    )  # fmt: skip
    return np.clip(image * light[..., None], 0, 255).astype(np.uint8)


def draw_markers(rng: np.random.Generator, size: int) -> np.ndarray:
    """Draws a board of fiducial markers, (size, size, 3) uint8 RGB."""
    cells = int(rng.integers(2, 7))
    side = size // cells
    paper = rng.integers(190, 256)
    image = np.full((size, size), paper, np.uint8)
    border = max(1, side // 8)
    for row in range(cells):
        for column in range(cells):
            bits = rng.integers(0, 2, (4, 4)).astype(np.uint8) * paper
            code = np.pad(bits, 1, constant_values=rng.integers(0, 60))
            inner = side - 2 * border
            if inner < 1 or rng.uniform() < 0.1:
                continue
            y, x = row * side + border, column * side + border
            image[y : y + inner, x : x + inner] = cv2.resize(
                code, (inner, inner), interpolation=cv2.INTER_NEAREST
            )
    return cv2.merge([image] * 3)


def _color(rng: np.random.Generator) -> tuple[float, ...]:
    """A random color, RGB in 0 to 255: often saturated, sometimes gray."""
    saturation = rng.uniform(0.4, 1.0) if rng.uniform() < 0.6 else rng.beta(0.8, 6.0)
    rgb = colorsys.hsv_to_rgb(rng.uniform(), saturation, rng.beta(1.2, 0.9))
    return tuple(255 * c for c in rgb)


def _clouds(rng: np.random.Generator, size: int, palette: list[tuple[float, ...]]) -> np.ndarray:
    """Mixes two colors by noise of several octaves, (size, size, 3) uint8."""
    mix = np.zeros((size, size), np.float32)
    cells, weight = int(rng.integers(2, 6)), 0.6
    while cells < size:
        grid = rng.random((cells, cells), dtype=np.float32) - 0.5
        mix += weight * cv2.resize(grid, (size, size), interpolation=cv2.INTER_LINEAR)
        cells, weight = 4 * cells, weight * rng.uniform(0.3, 0.8)
    mix = np.clip(mix + 0.5, 0, 1)[..., None]
    first, second = (np.array(palette[i], np.float32) for i in (0, -1))
    return (first + (second - first) * mix).astype(np.uint8)


def draw_leaf(
    image: np.ndarray,
    rng: np.random.Generator,
    radius: float,
    color: Sequence[float],
    center: np.ndarray,
) -> None:
    """Draws a rectangle, an ellipse, a polygon or a line, in place.

    Args:
        image: (H, W, 3) uint8.
        rng: draws kind, shape and rotation.
        radius: half the larger side in pixels.
        color: RGB, 0 to 255.
        center: (2,) pixels.
    """
    kind = rng.choice(["rectangle", "ellipse", "polygon", "line"], p=[0.4, 0.25, 0.2, 0.15])
    angle = rng.normal(0, 0.1) if rng.uniform() < 0.4 else rng.uniform(0, np.pi)
    axes = radius * np.array([1.0, rng.uniform(0.25, 1.0)])
    if kind == "ellipse":
        box = (center.tolist(), (2 * axes).tolist(), float(np.degrees(angle)))
        cv2.ellipse(image, box, color, -1, cv2.LINE_AA)
        return
    cos, sin = np.cos(angle), np.sin(angle)
    if kind == "line":
        step = 2 * radius * np.array([cos, sin])
        start, end = (np.rint(center + s * step).astype(int).tolist() for s in (-1, 1))
        width = int(rng.integers(1, max(2, round(radius / 4)) + 1))
        cv2.line(image, start, end, color, width, cv2.LINE_AA)
        return
    if kind == "rectangle":
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * axes
    else:
        around = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 8))))
        corners = np.stack([np.cos(around), np.sin(around)], -1) * axes
    points = np.rint(corners @ np.array([[cos, sin], [-sin, cos]]) + center).astype(np.int32)
    cv2.fillPoly(image, [points], color, cv2.LINE_AA)
    if kind == "rectangle" and rng.uniform() < 0.3:
        edge = tuple(float(c) for c in rng.integers(0, 256, 3))
        cv2.polylines(image, [points], True, edge, int(rng.integers(1, 4)), cv2.LINE_AA)


def _draw_text(image: np.ndarray, rng: np.random.Generator, color: tuple[float, ...]) -> None:
    """Draws a few lines of letters, in place."""
    size = len(image)
    scale = size / 512 * np.exp(rng.uniform(np.log(0.4), np.log(3.0)))
    x, y = rng.uniform(-0.1, 0.7, 2) * size
    font = int(rng.integers(0, 5))
    for line in range(int(rng.integers(1, 8))):
        word = "".join(rng.choice(_LETTERS, int(rng.integers(3, 16))))
        at = (round(x), round(y + line * 32 * scale))
        thickness = max(1, round(scale * rng.uniform(0.8, 2.5)))
        cv2.putText(image, word, at, font, scale, color, thickness, cv2.LINE_AA)
