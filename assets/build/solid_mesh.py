"""From a solid to a mesh of its real size: the zero level, decimated and fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import fast_simplification
import manifold3d
import numpy as np
import trimesh

from ...core.errors import InputError
from .size_fit import fit_size
from .solids import Solid, Vector


@dataclass(frozen=True)
class MeshedSolid:
    """A solid brought to its real size.

    Attributes:
        mesh: watertight, in one piece, meters, centered on its bounding box.
        to_solid: maps points (N, 3) of the mesh's frame back to the solid's coordinates.
        bend: how far the corners had to be pulled in to meet the diameter, at most
            `size_fit.MAX_BEND`.
    """

    mesh: trimesh.Trimesh
    to_solid: Callable[[np.ndarray], np.ndarray]
    bend: float


def mesh_solid(solid: Solid, extents_m: Vector, diameter_m: float) -> MeshedSolid:
    """Meshes a solid and fits it to the given size; see `size_fit.fit_size`.

    Args:
        solid: the object.
        extents_m: (3,) side lengths of the bounding box, meters.
        diameter_m: largest distance between two points of the surface, meters.

    Raises:
        InputError: if the surface is open (``bounds`` too tight), comes in several pieces, or is
            of a shape that cannot be brought to the diameter.
    """
    vertices, faces = _decimate(_level_set(solid), solid.faces, solid.edge_length)
    fit = fit_size(vertices, extents_m, diameter_m)
    return MeshedSolid(trimesh.Trimesh(fit.points, faces, process=False), fit.undo, fit.bend)


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
        raise InputError(f"the solid has no surface within bounds {bounds.tolist()}")
    box_low, box_high = np.reshape(surface.bounding_box(), (2, 3))
    if (box_low <= bounds[0]).any() or (box_high >= bounds[1]).any():
        raise InputError(
            f"bounds {bounds.tolist()} cut the solid, which reaches from "
            f"{box_low.tolist()} to {box_high.tolist()}"
        )
    # Cavities, which nobody sees, and folds of slivers are pieces too, of no volume of their own.
    crumb = solid.edge_length**3
    pieces = [piece for piece in surface.decompose() if piece.volume() > crumb]
    if len(pieces) != 1:
        boxes = [np.round(piece.bounding_box(), 3).tolist() for piece in pieces]
        raise InputError(f"a solid must be in one piece, this one has {len(pieces)}, at {boxes}")
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
    raise InputError(f"the surface tears when reduced to {count} faces; try another edge_length")
