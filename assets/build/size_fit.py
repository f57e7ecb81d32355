"""Brings points to a given bounding box and diameter, and back.

Each axis is scaled so that the bounding box is exact. The diameter is then met by a gentle bend
that pulls the box's corners in (or out) and leaves horizontal planes horizontal, so a flat base
stays flat.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from ...core.errors import InputError
from .solids import Vector

MAX_BEND = 0.2
"""Largest bend that a fit may need; beyond it the shape would visibly warp."""

BEND_PRICE = 0.1
"""Relative error of the diameter that a bend of 1 must save, so that none is made for nothing."""

MAX_DIAMETER_ERROR = 0.01
"""Relative error of the diameter that is tolerated."""


@dataclass(frozen=True, eq=False)
class SizeFit:
    """Points brought to their real size.

    Attributes:
        points: (N, 3), meters, their bounding box centered on the origin.
        undo: maps points (M, 3) of their frame back to where the given points came from.
        bend: how far the corners had to be pulled in, at most `MAX_BEND`.
    """

    points: np.ndarray
    undo: Callable[[np.ndarray], np.ndarray]
    bend: float


def fit_size(vertices: np.ndarray, extents_m: Vector, diameter_m: float) -> SizeFit:
    """Fits points to a size.

    Args:
        vertices: (N, 3), in units of their own.
        extents_m: (3,) side lengths of the bounding box, meters.
        diameter_m: largest distance between two of the points, meters.

    Raises:
        InputError: if a bend of `MAX_BEND` does not bring them to the diameter.
    """
    target = np.asarray(extents_m, dtype=float)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    center, half = (low + high) / 2, (high - low) / 2
    unit = (vertices - center) / half

    def excess(bend: float) -> float:
        return _diameter(_fit(_bend(unit, bend), target)[0]) - diameter_m

    bend = _best_bend(lambda bend: abs(excess(bend)) / diameter_m + BEND_PRICE * abs(bend))
    if abs(excess(bend)) > MAX_DIAMETER_ERROR * diameter_m:
        raise InputError(
            f"diameter_m {diameter_m:.4f} is out of this shape's reach: with the extents "
            f"{target.tolist()} it is {diameter_m + excess(0.0):.4f} unbent and "
            f"{diameter_m + excess(bend):.4f} at best"
        )
    points, scale, offset = _fit(_bend(unit, bend), target)

    def undo(points: np.ndarray) -> np.ndarray:
        return _unbend((points - offset) / scale, bend) * half + center

    return SizeFit(points, undo, bend)


def _diameter(points: np.ndarray) -> float:
    """Largest distance between two points."""
    return float(pdist(points[ConvexHull(points).vertices]).max())


def _fit(points: np.ndarray, extents: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3) with bounding box ``extents`` about the origin, and the scale and offset."""
    low, high = points.min(axis=0), points.max(axis=0)
    scale = extents / (high - low)
    offset = -scale * (low + high) / 2
    return points * scale + offset, scale, offset


def _best_bend(cost: Callable[[float], float]) -> float:
    """The bend of least cost: a scan, since the cost has several valleys, then a descent."""
    grid = np.linspace(-MAX_BEND, MAX_BEND, 41)
    best = grid[np.argmin([cost(bend) for bend in grid])]
    step, options = grid[1] - grid[0], {"xatol": 1e-5}
    around = (max(best - step, -MAX_BEND), min(best + step, MAX_BEND))
    found = minimize_scalar(cost, bounds=around, method="bounded", options=options)
    return float(found.x) if found.fun < cost(best) else float(best)


def _bend(unit: np.ndarray, bend: float) -> np.ndarray:
    """Pulls points of the cube [-1, 1]^3 towards the z axis, the more the nearer to a corner."""
    squared = unit**2
    x = unit[:, 0] * (1 - bend * (squared[:, 1] + squared[:, 2]))
    y = unit[:, 1] * (1 - bend * (squared[:, 0] + squared[:, 2]))
    return np.stack([x, y, unit[:, 2]], axis=1)


def _unbend(points: np.ndarray, bend: float) -> np.ndarray:
    """Inverse of `_bend`, by fixed-point iteration (a contraction for bends up to MAX_BEND)."""
    x, y, z2 = points[:, 0], points[:, 1], points[:, 2] ** 2
    for _ in range(60):
        x = points[:, 0] / (1 - bend * (y**2 + z2))
        y = points[:, 1] / (1 - bend * (x**2 + z2))
    return np.stack([x, y, points[:, 2]], axis=1)
