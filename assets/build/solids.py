"""Objects as formulas: signed distance functions, how they combine, and their colors.

A signed distance function maps points (N, 3) to (N,) values, negative inside. Ours are exact or a
lower bound on the distance (ellipsoids, smooth unions), and their zero level is always exact. See
https://iquilezles.org/articles/distfunctions for the formulas. `solid_mesh` makes meshes of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

Sdf = Callable[[np.ndarray], np.ndarray]
"""Points (N, 3) to signed distances (N,), negative inside."""

Color = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Points (N, 3) and unit outward normals (N, 3) to RGB (N, 3) in [0, 1]."""

Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Solid:
    """One object as a formula, in units of its own choosing.

    Attributes:
        sdf: its shape.
        color: its surface color. Points are in solid coordinates, unit normals are those of the
            finished mesh (`solid_mesh.MeshedSolid.to_solid` goes back from it).
        bounds: (2, 3) box to look for the surface in; it must contain it with a little room.
        edge_length: size of the meshing grid.
        faces: how many triangles the finished mesh should have.
        specular: MuJoCo material specularity, 0 to 1.
        shininess: MuJoCo material shininess, 0 to 1.
    """

    sdf: Sdf
    color: Color
    bounds: np.ndarray
    edge_length: float
    faces: int = 2500
    specular: float = 0.2
    shininess: float = 0.3


# Primitives


def sphere(center: Vector, radius: float) -> Sdf:
    """A ball."""
    c = np.asarray(center, dtype=float)
    return lambda p: np.linalg.norm(p - c, axis=1) - radius


def ellipsoid(center: Vector, radii: Vector) -> Sdf:
    """An ellipsoid with semi-axes along x, y, z; the distance is first order."""
    c, r = np.asarray(center, dtype=float), np.asarray(radii, dtype=float)

    def sdf(p: np.ndarray) -> np.ndarray:
        scaled = (p - c) / r
        k0 = np.linalg.norm(scaled, axis=1)
        k1 = np.linalg.norm(scaled / r, axis=1)
        return np.where(k1 > 0, k0 * (k0 - 1.0) / np.maximum(k1, 1e-12), -r.min())

    return sdf


def box(center: Vector, size: Vector, rounding: float = 0.0) -> Sdf:
    """A box of full side lengths ``size``, its edges rounded with radius ``rounding``."""
    c, half = np.asarray(center, dtype=float), np.asarray(size, dtype=float) / 2 - rounding

    def sdf(p: np.ndarray) -> np.ndarray:
        return _outside_and_inside(np.abs(p - c) - half) - rounding

    return sdf


def capsule(a: Vector, b: Vector, radius: float, radius_b: float | None = None) -> Sdf:
    """A segment from ``a`` to ``b`` thickened to ``radius``, tapering to ``radius_b`` at ``b``."""
    start, end = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    step, last = end - start, radius if radius_b is None else radius_b

    def sdf(p: np.ndarray) -> np.ndarray:
        t = np.clip((p - start) @ step / (step @ step), 0.0, 1.0)
        thickness = radius + t * (last - radius)
        return np.linalg.norm(p - start - t[:, None] * step, axis=1) - thickness

    return sdf


def cylinder(
    a: Vector, b: Vector, radius: float, radius_b: float | None = None, rounding: float = 0.0
) -> Sdf:
    """A flat-ended cylinder from ``a`` to ``b``, or a cone where ``radius_b`` differs."""
    start, end = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    length = float(np.linalg.norm(end - start))
    axis, middle, h = (end - start) / length, (start + end) / 2, length / 2 - rounding
    r1 = radius - rounding
    r2 = (radius if radius_b is None else radius_b) - rounding
    slope = np.array([r2 - r1, 2 * h])

    def sdf(p: np.ndarray) -> np.ndarray:
        along = (p - middle) @ axis
        rho = np.linalg.norm(p - middle - along[:, None] * axis, axis=1)
        # Distance to the nearer end disc and to the slanted side; the sign tells inside.
        cap = np.stack([rho - np.minimum(rho, np.where(along < 0, r1, r2)), np.abs(along) - h], 1)
        t = np.clip(((r2 - rho) * slope[0] + (h - along) * slope[1]) / (slope @ slope), 0.0, 1.0)
        side = np.stack([rho - r2 + slope[0] * t, along - h + slope[1] * t], 1)
        sign = np.where((side[:, 0] < 0) & (cap[:, 1] < 0), -1.0, 1.0)
        nearest = np.minimum((cap**2).sum(1), (side**2).sum(1))
        return sign * np.sqrt(nearest) - rounding

    return sdf


def torus(center: Vector, axis: Vector, major: float, minor: float) -> Sdf:
    """A ring of radius ``major`` about ``axis``, of thickness radius ``minor``."""
    c, n = np.asarray(center, dtype=float), np.asarray(axis, dtype=float)
    n = n / np.linalg.norm(n)

    def sdf(p: np.ndarray) -> np.ndarray:
        along = (p - c) @ n
        rho = np.linalg.norm(p - c - along[:, None] * n, axis=1)
        return np.hypot(rho - major, along) - minor

    return sdf


def half_space(point: Vector, normal: Vector) -> Sdf:
    """All that lies behind the plane through ``point``; ``normal`` points outward."""
    c, n = np.asarray(point, dtype=float), np.asarray(normal, dtype=float)
    n = n / np.linalg.norm(n)
    return lambda p: (p - c) @ n


def prism(
    outline: Sequence[Vector], axis: int, low: float, high: float, rounding: float = 0.0
) -> Sdf:
    """A polygon extruded along a coordinate axis.

    Args:
        outline: (M, 2) corners; the coordinates are the two other axes in their order x, y, z.
        axis: 0, 1 or 2, the direction of extrusion.
        low: start of the prism along ``axis``.
        high: its end.
        rounding: edge radius; it is added around the outline, and kept within low and high.
    """
    corners = np.asarray(outline, dtype=float)
    others = [i for i in range(3) if i != axis]
    middle, half = (low + high) / 2, (high - low) / 2 - rounding

    def sdf(p: np.ndarray) -> np.ndarray:
        flat = p[:, others]
        nearest = np.full(len(p), np.inf)
        inside = np.zeros(len(p), dtype=bool)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            edge, offset = b - a, flat - a
            t = np.clip(offset @ edge / (edge @ edge), 0.0, 1.0)
            nearest = np.minimum(nearest, ((offset - t[:, None] * edge) ** 2).sum(1))
            crosses = (a[1] > flat[:, 1]) != (b[1] > flat[:, 1])
            turn = edge[0] * offset[:, 1] - edge[1] * offset[:, 0]
            inside ^= crosses & ((turn > 0) == (edge[1] < 0))
        planar = np.where(inside, -1.0, 1.0) * np.sqrt(nearest)
        caps = np.abs(p[:, axis] - middle) - half
        return _outside_and_inside(np.stack([planar, caps], axis=1)) - rounding

    return sdf


def _outside_and_inside(q: np.ndarray) -> np.ndarray:
    """Distance to the corner where all of q (N, D) are zero and inside is all negative."""
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


# Combinations


def union(*sdfs: Sdf, smooth: float = 0.0) -> Sdf:
    """All of the parts together; ``smooth`` is the width of the fillet where they meet."""

    def sdf(p: np.ndarray) -> np.ndarray:
        value = sdfs[0](p)
        for part in sdfs[1:]:
            value = _smooth_min(value, part(p), smooth)
        return value

    return sdf


def intersect(*sdfs: Sdf, smooth: float = 0.0) -> Sdf:
    """What all of the parts share."""

    def sdf(p: np.ndarray) -> np.ndarray:
        value = -sdfs[0](p)
        for part in sdfs[1:]:
            value = _smooth_min(value, -part(p), smooth)
        return -value

    return sdf


def subtract(body: Sdf, *cuts: Sdf, smooth: float = 0.0) -> Sdf:
    """``body`` without the ``cuts``."""

    def sdf(p: np.ndarray) -> np.ndarray:
        value = -body(p)
        for cut in cuts:
            value = _smooth_min(value, cut(p), smooth)
        return -value

    return sdf


def moved(sdf: Sdf, offset: Vector = (0, 0, 0), degrees: Vector = (0, 0, 0)) -> Sdf:
    """Turns a shape about the origin (about fixed x, then y, then z), then shifts it."""
    shift = np.asarray(offset, dtype=float)
    rotation = Rotation.from_euler("xyz", np.asarray(degrees, dtype=float), degrees=True)
    matrix = rotation.as_matrix()
    return lambda p: sdf((p - shift) @ matrix)


def mirrored(sdf: Sdf, axis: int) -> Sdf:
    """The positive half of a shape along ``axis``, and its mirror image."""

    def both(p: np.ndarray) -> np.ndarray:
        folded = p.copy()
        folded[:, axis] = np.abs(folded[:, axis])
        return sdf(folded)

    return both


def _smooth_min(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Minimum, blended by a quadratic where a and b differ by less than ``width``."""
    smallest = np.minimum(a, b)
    if width <= 0:
        return smallest
    return smallest - np.maximum(width - np.abs(a - b), 0.0) ** 2 / (4 * width)


def painted(base: Vector | Color, *layers: tuple[Sdf, Vector]) -> Color:
    """A ground painted over inside each region in turn: (region, RGB) pairs, the last on top."""

    def color(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        if callable(base):
            rgb = np.array(base(points, normals), dtype=float)
        else:
            rgb = np.tile(np.asarray(base, dtype=float), (len(points), 1))
        for region, paint in layers:
            rgb[region(points) < 0] = paint
        return rgb

    return color


def colored_parts(*parts: tuple[Sdf, Vector]) -> Color:
    """Each point has the color of the part whose surface is nearest: (part, RGB) pairs."""
    palette = np.array([paint for _, paint in parts], dtype=float)

    def color(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        distances = np.stack([np.abs(part(points)) for part, _ in parts])
        return palette[distances.argmin(axis=0)]

    return color
