"""Anyone's mesh as an object: one texture, meters, few enough triangles, keypoints, resting poses.

Per-vertex colors, per-face colors and textures are all read as colors of points spread densely
over the original surface, and baked from there. So the mesh may be thinned out, cut into charts
and put together from many parts without a thought for where its colors came from.
"""

from __future__ import annotations

import re
import zlib
from functools import lru_cache
from pathlib import Path

import fast_simplification
import numpy as np
import trimesh
from scipy.spatial import KDTree

from ..core.errors import InputError
from ..core.geometry import check_rigid
from . import surface, texture
from .mesh_cache import cached, mesh_key
from .object_model import ObjectModel
from .surface_colors import NORMAL_WEIGHT, sample_colors

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".glb")
"""What `import_mesh` reads."""

MAX_FACES = 4000
"""Heavier meshes are thinned out; the renderer's time goes with the number of faces."""

TEXTURE_SIZE = 512
UNITS = {"m": 1.0, "mm": 1e-3}

_METERS = (0.02, 1.0)
_MILLIMETERS = (20.0, 1000.0)
PLAUSIBLE_RANGE = (1e-3, 10.0)
"""Diameters of objects, meters."""


def import_mesh(
    path: str | Path,
    name: str | None = None,
    *,
    unit: str = "auto",
    symmetries: np.ndarray | None = None,
    diameter: float | None = None,
) -> ObjectModel:
    """Reads a mesh file; the second call with the same arguments returns the same instance.

    Other processes, and later ones, find the result on the disk: see `mesh_cache`.

    The object keeps the file's own frame, only scaled to meters, so that poses mean what they mean
    for the file. The ninth keypoint is the center of the bounding box.

    Args:
        path: PLY, OBJ, STL or GLB; all parts of a scene become one object.
        name: of the object; the file's name without ending by default.
        unit: "m", "mm", or "auto": a diameter of 0.02 to 1 is taken as meters, of 20 to 1000 as
            millimeters.
        symmetries: (S, 4, 4) transforms in meters under which the object looks the same.
        diameter: of the object as others measure it, meters; by default the largest distance
            between two vertices, from which it may differ by a tenth.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if the file is no readable mesh, has no faces or NaN vertices, if its unit is
            not evident or its size implausible or not that of ``diameter``, or ``symmetries``
            are not rigid transforms.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"mesh file {path} does not exist")
    if unit != "auto" and unit not in UNITS:
        raise InputError(f"unit must be 'auto', 'm' or 'mm', got {unit!r}")
    given = None if symmetries is None else _check_symmetries(symmetries)
    state = path.stat()
    options = (name, unit, given, diameter)
    return _import(path.resolve(), *options, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=64)
def _import(
    path: Path,
    name: str | None,
    unit: str,
    symmetries: bytes | None,
    diameter: float | None,
    modified: int,
    size: int,
) -> ObjectModel:
    """Imports or finds what was; ``modified`` and ``size`` make a changed file another entry."""
    options = (name, unit, symmetries, diameter)
    key = mesh_key(path, (*options, MAX_FACES, TEXTURE_SIZE, CACHE_VERSION))
    return cached(key, lambda: _make(path, *options))


CACHE_VERSION = 1
"""Of what `_make` returns: raise it with every change to that, so that no old entry is found."""


def _make(
    path: Path, name: str | None, unit: str, symmetries: bytes | None, diameter: float | None
) -> ObjectModel:
    """Imports."""
    parts = _read_parts(path)
    measured = surface.diameter(np.concatenate([part.triangles.reshape(-1, 3) for part in parts]))
    scale = _scale(measured, unit, path)
    if diameter is not None and not 0.9 < measured * scale / diameter < 1.1:
        raise InputError(
            f"{path} has a diameter of {measured * scale:g} m, but diameter is given as "
            f"{diameter:g} m"
        )
    for part in parts:
        part.apply_scale(scale)

    mesh = _weld(parts)
    outward = mesh.is_winding_consistent and mesh.volume > 0
    if not outward:
        mesh.fix_normals()
    mesh = _decimate(mesh)
    points, normals, colors = sample_colors(parts)
    # Normals tell the two sides of a thin wall apart, where the file has them right.
    reach = NORMAL_WEIGHT * measured * scale if outward else 0.0
    tree = KDTree(np.concatenate([points, reach * normals], axis=1))

    def color_at(places: np.ndarray, directions: np.ndarray) -> np.ndarray:
        _, nearest = tree.query(np.concatenate([places, reach * directions], axis=1))
        return colors[nearest]

    vertices, faces, uv = texture.unwrap(mesh, TEXTURE_SIZE, tight=False)
    image = texture.bake(vertices, faces, uv, color_at, TEXTURE_SIZE, supersampling=1)
    transforms = np.eye(4)[None]
    if symmetries is not None:
        transforms = np.frombuffer(symmetries).reshape(-1, 4, 4).copy()
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return ObjectModel(
        name=name or path.stem,
        obj_id=_number(path.stem),
        vertices=vertices,
        faces=faces,
        uv=uv,
        texture=image,
        keypoints=surface.keypoints(vertices, center, transforms),
        diameter=measured * scale if diameter is None else diameter,
        symmetries=transforms,
        points=surface.even_points(mesh),
        stable_poses=surface.stable_poses(mesh),
    )


def _read_parts(path: Path) -> list[trimesh.Trimesh]:
    """All meshes of a file in its own frame and unit, each with its colors."""
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"{path.name} must be one of {', '.join(MESH_SUFFIXES)}")
    try:
        scene = trimesh.load_scene(path, process=False)
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    except Exception as error:  # readers of broken files fail in every way there is
        raise InputError(f"{path} cannot be read as a mesh: {error!r}") from error
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise InputError(f"{path} has no faces: a surface is needed, not points")
    for part in parts:
        if not np.isfinite(part.vertices).all():
            bad = int((~np.isfinite(part.vertices).all(axis=1)).sum())
            raise InputError(f"{path} has NaN or infinite coordinates in {bad} vertices")
        if part.faces.min() < 0 or part.faces.max() >= len(part.vertices):
            raise InputError(f"{path} has faces with vertices that it does not have")
    corners = np.concatenate([part.triangles.reshape(-1, 3) for part in parts])
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    if spread[2] <= 1e-6 * spread[0]:
        raise InputError(f"{path} is flat: an object needs some thickness")
    return parts


def _scale(diameter: float, unit: str, path: Path) -> float:
    """What the file's numbers are multiplied with to be meters."""
    if unit == "auto":
        for guess, (low, high) in (("m", _METERS), ("mm", _MILLIMETERS)):
            if low <= diameter <= high:
                return UNITS[guess]
        raise InputError(
            f"the unit of {path} is not evident: its diameter is {diameter:g}, and "
            f"{_METERS[0]:g} to {_METERS[1]:g} would be meters, {_MILLIMETERS[0]:g} to "
            f"{_MILLIMETERS[1]:g} millimeters; say unit='m' or unit='mm' to import_mesh, or scale "
            "the file"
        )
    meters = diameter * UNITS[unit]
    if not PLAUSIBLE_RANGE[0] <= meters <= PLAUSIBLE_RANGE[1]:
        raise InputError(
            f"{path} has a diameter of {diameter:g} {unit} = {meters:g} m; objects must be "
            f"{PLAUSIBLE_RANGE[0]:g} to {PLAUSIBLE_RANGE[1]:g} m"
        )
    return UNITS[unit]


def _weld(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh without colors; vertices at one place become one."""
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + o for part, o in zip(parts, offsets, strict=False)])
    mesh = trimesh.Trimesh(vertices, faces)
    mesh.update_faces(mesh.unique_faces() & mesh.nondegenerate_faces(height=0.0))
    mesh.remove_unreferenced_vertices()
    return mesh


def _decimate(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Quadric edge collapse to ``MAX_FACES``."""
    if len(mesh.faces) <= MAX_FACES:
        return mesh
    size = float(mesh.extents.max())  # the collapse's thresholds are lengths
    for pace in (3.0, 5.0, 7.0):
        vertices, faces = fast_simplification.simplify(
            mesh.vertices / size, mesh.faces, target_count=MAX_FACES, agg=pace
        )
        decimated = trimesh.Trimesh(vertices * size, faces)
        decimated.update_faces(decimated.nondegenerate_faces(height=0.0))
        decimated.remove_unreferenced_vertices()
        if len(decimated.faces) <= MAX_FACES:
            break
    return decimated


def _number(stem: str) -> int:
    """BOP's number in names like obj_000005; for others one of six digits made from the name."""
    match = re.fullmatch(r"obj_(\d+)", stem)
    return int(match[1]) if match else 100_000 + zlib.crc32(stem.encode()) % 900_000


def _check_symmetries(symmetries: np.ndarray) -> bytes:
    """Rigid transforms (S, 4, 4), identity first, as bytes: a key for the cache."""
    array = np.asarray(symmetries, dtype=np.float64)
    if array.ndim != 3 or array.shape[1:] != (4, 4) or not len(array):
        raise InputError(f"symmetries must have the shape (S, 4, 4), got {array.shape}")
    checked = [check_rigid(T, f"symmetries[{i}]") for i, T in enumerate(array)]
    others = [T for T in checked if not np.allclose(T, np.eye(4), atol=1e-9)]
    return np.stack([np.eye(4), *others]).tobytes()
