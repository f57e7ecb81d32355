"""Objects as formulas: signed distance functions, and how one becomes a mesh of a given size.

A signed distance function maps points (N, 3) to (N,) values, negative inside. Ours are exact or a
lower bound on the distance (ellipsoids, smooth unions), and their zero level is always exact. See
https://iquilezles.org/articles/distfunctions for the formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import fast_simplification
import manifold3d
import numpy as np
import trimesh
from scipy.optimize import minimize_scalar
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

Sdf = Callable[[np.ndarray], np.ndarray]
"""Points (N, 3) to signed distances (N,), negative inside."""

Colour = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Points (N, 3) and unit outward normals (N, 3) to RGB (N, 3) in [0, 1]."""

Vector = Sequence[float] | np.ndarray

MAX_BEND = 0.2
"""Largest bend that `mesh_solid` may need; beyond it the shape would visibly warp."""

BEND_PRICE = 0.1
"""Relative error of the diameter that a bend of 1 must save, so that none is made for nothing."""

MAX_DIAMETER_ERROR = 0.01
"""Relative error of the diameter that `mesh_solid` tolerates."""


# Primitives


def sphere(centre: Vector, radius: float) -> Sdf:
    """A ball."""
    c = np.asarray(centre, dtype=float)
    return lambda p: np.linalg.norm(p - c, axis=1) - radius


def ellipsoid(centre: Vector, radii: Vector) -> Sdf:
    """An ellipsoid with semi-axes along x, y, z; the distance is first order."""
    c, r = np.asarray(centre, dtype=float), np.asarray(radii, dtype=float)

    def sdf(p: np.ndarray) -> np.ndarray:
        scaled = (p - c) / r
        k0 = np.linalg.norm(scaled, axis=1)
        k1 = np.linalg.norm(scaled / r, axis=1)
        return np.where(k1 > 0, k0 * (k0 - 1.0) / np.maximum(k1, 1e-12), -r.min())

    return sdf


def box(centre: Vector, size: Vector, rounding: float = 0.0) -> Sdf:
    """A box of full side lengths ``size``, its edges rounded with radius ``rounding``."""
    c, half = np.asarray(centre, dtype=float), np.asarray(size, dtype=float) / 2 - rounding

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


def torus(centre: Vector, axis: Vector, major: float, minor: float) -> Sdf:
    """A ring of radius ``major`` about ``axis``, of thickness radius ``minor``."""
    c, n = np.asarray(centre, dtype=float), np.asarray(axis, dtype=float)
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


def painted(base: Vector | Colour, *layers: tuple[Sdf, Vector]) -> Colour:
    """A ground painted over inside each region in turn: (region, RGB) pairs, the last on top."""

    def colour(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        if callable(base):
            rgb = np.array(base(points, normals), dtype=float)
        else:
            rgb = np.tile(np.asarray(base, dtype=float), (len(points), 1))
        for region, paint in layers:
            rgb[region(points) < 0] = paint
        return rgb

    return colour


def coloured_parts(*parts: tuple[Sdf, Vector]) -> Colour:
    """Each point has the colour of the part whose surface is nearest: (part, RGB) pairs."""
    palette = np.array([paint for _, paint in parts], dtype=float)

    def colour(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        distances = np.stack([np.abs(part(points)) for part, _ in parts])
        return palette[distances.argmin(axis=0)]

    return colour


# From solid to mesh


@dataclass(frozen=True)
class Solid:
    """One object as a formula, in units of its own choosing.

    Attributes:
        sdf: its shape.
        colour: its surface colour. Points are in solid coordinates (`MeshedSolid.to_solid`), unit
            normals are those of the finished mesh.
        bounds: (2, 3) box to look for the surface in; it must contain it with a little room.
        edge_length: size of the meshing grid.
        faces: how many triangles the finished mesh should have.
        specular: MuJoCo material specularity, 0 to 1.
        shininess: MuJoCo material shininess, 0 to 1.
    """

    sdf: Sdf
    colour: Colour
    bounds: np.ndarray
    edge_length: float
    faces: int = 2500
    specular: float = 0.2
    shininess: float = 0.3


@dataclass(frozen=True)
class MeshedSolid:
    """A solid brought to its real size.

    Attributes:
        mesh: watertight, in one piece, metres, centred on its bounding box.
        to_solid: maps points (N, 3) of the mesh's frame back to the solid's coordinates.
        bend: how far the corners had to be pulled in to meet the diameter, at most `MAX_BEND`.
    """

    mesh: trimesh.Trimesh
    to_solid: Callable[[np.ndarray], np.ndarray]
    bend: float


def mesh_solid(solid: Solid, extents_m: Vector, diameter_m: float) -> MeshedSolid:
    """Meshes a solid and fits it to the given size.

    Each axis is scaled so that the bounding box is exact. The diameter is then met by a gentle
    bend that pulls the box's corners in (or out) and leaves horizontal planes horizontal, so a
    flat base stays flat.

    Args:
        solid: the object.
        extents_m: (3,) side lengths of the bounding box, metres.
        diameter_m: largest distance between two points of the surface, metres.

    Raises:
        ValueError: if the surface is open (``bounds`` too tight), comes in several pieces, or is
            of a shape that a bend of `MAX_BEND` does not bring to the diameter.
    """
    target = np.asarray(extents_m, dtype=float)
    vertices, faces = _decimate(_level_set(solid), solid.faces, solid.edge_length)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, half = (low + high) / 2, (high - low) / 2
    unit = (vertices - centre) / half

    def excess(bend: float) -> float:
        return _diameter(_fit(_bend(unit, bend), target)[0]) - diameter_m

    bend = _best_bend(lambda bend: abs(excess(bend)) / diameter_m + BEND_PRICE * abs(bend))
    if abs(excess(bend)) > MAX_DIAMETER_ERROR * diameter_m:
        raise ValueError(
            f"diameter_m {diameter_m:.4f} is out of this shape's reach: with the extents "
            f"{target.tolist()} it is {diameter_m + excess(0.0):.4f} unbent and "
            f"{diameter_m + excess(bend):.4f} at best"
        )
    fitted, scale, offset = _fit(_bend(unit, bend), target)

    def to_solid(points: np.ndarray) -> np.ndarray:
        return _unbend((points - offset) / scale, bend) * half + centre

    return MeshedSolid(trimesh.Trimesh(fitted, faces, process=False), to_solid, bend)


def _level_set(solid: Solid) -> manifold3d.Manifold:
    """The zero level as one closed surface.

    Manifold asks for one value at a time, at grid points that do not depend on the answers. So it
    is asked twice: once to learn the points, which are then evaluated all together.
    """
    bounds = np.asarray(solid.bounds, dtype=float)
    limits = (*bounds[0], *bounds[1])
    asked: list[tuple[float, float, float]] = []

    def learn(x: float, y: float, z: float) -> float:
        asked.append((x, y, z))
        return -1.0

    manifold3d.Manifold.level_set(learn, limits, solid.edge_length)
    known = dict(zip(asked, (-solid.sdf(np.array(asked))).tolist(), strict=True))
    surface = manifold3d.Manifold.level_set(
        lambda x, y, z: known[x, y, z], limits, solid.edge_length
    )
    if surface.is_empty():
        raise ValueError(f"the solid has no surface within bounds {bounds.tolist()}")
    box_low, box_high = np.reshape(surface.bounding_box(), (2, 3))
    if (box_low <= bounds[0]).any() or (box_high >= bounds[1]).any():
        raise ValueError(
            f"bounds {bounds.tolist()} cut the solid, which reaches from "
            f"{box_low.tolist()} to {box_high.tolist()}"
        )
    # Cavities, which nobody sees, and folds of slivers are pieces too, of no volume of their own.
    crumb = solid.edge_length**3
    pieces = [piece for piece in surface.decompose() if piece.volume() > crumb]
    if len(pieces) != 1:
        boxes = [np.round(piece.bounding_box(), 3).tolist() for piece in pieces]
        raise ValueError(f"a solid must be in one piece, this one has {len(pieces)}, at {boxes}")
    return pieces[0]


def _decimate(
    surface: manifold3d.Manifold, count: int, edge_length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and faces (F, 3): quadric edge collapse to ``count`` faces, still closed.

    Now and then a collapse pinches the surface. Another pace or count then goes another way, and
    at last a start without slivers, though that start makes round things look carved.
    """
    low, high = np.reshape(surface.bounding_box(), (2, 3))
    size = float((high - low).max())  # the thresholds of the collapse are lengths
    ways = product((0.0, 0.02, 0.05, 0.1, 0.2), (1.0, 0.96, 0.92), (3.0, 3.5, 4.0, 5.0))
    for sliver, part, aggression in ways:
        start = (surface.simplify(sliver * edge_length) if sliver else surface).to_mesh64()
        points = np.array(start.vert_properties[:, :3], dtype=float, order="C") / size
        triangles = np.array(start.tri_verts, dtype=np.int64, order="C")
        slim, slim_faces = fast_simplification.simplify(
            points, triangles, target_count=int(part * count), agg=aggression
        )
        vertices = (slim * size).astype(np.float32).astype(float)  # as a file holds them
        mesh = trimesh.Trimesh(vertices, slim_faces)  # points that fall together become one
        edges_once = len(np.unique(mesh.edges, axis=0)) == len(mesh.edges)
        sound = mesh.is_watertight and mesh.is_winding_consistent and edges_once
        whole = mesh.body_count == 1 and len(mesh.faces) <= 1.05 * count
        if sound and whole and mesh.area_faces.min() > 1e-9 * mesh.area:
            return np.asarray(mesh.vertices), np.asarray(mesh.faces)
    raise ValueError(f"the surface tears when reduced to {count} faces; try another edge_length")


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
