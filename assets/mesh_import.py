"""Imports a mesh file as an object: meters, decimated, one texture, keypoints, stable poses.

Per-vertex colors, per-face colors and textures are all sampled at dense points on the original
surface and baked from there, so welding, decimation and unwrapping need not know about colors.
"""

import multiprocessing
import re
import zlib
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import KDTree

from ..core.errors import InputError
from ..core.geometry import check_rigid
from ..core.units import METERS, NAMES, check_unit, length, resolve_unit
from . import surface, texture
from .mesh_cache import cached, mesh_key
from .mesh_files import read_parts
from .object_model import ObjectModel
from .surface_colors import NORMAL_WEIGHT, sample_colors

MAX_FACES = 4000
"""Larger meshes are decimated; rendering time is proportional to the number of faces."""

TEXTURE_SIZE = 512


def import_mesh(
    path: str | Path,
    name: str | None = None,
    *,
    unit: str = "auto",
    symmetries: np.ndarray | None = None,
    diameter: float | None = None,
) -> ObjectModel:
    """Imports a mesh file, cached in the process and on disk (`mesh_cache`).

    The object keeps the file's own frame, scaled to meters, so poses refer to that frame. The ninth
    keypoint is the center of the bounding box.

    Args:
        path: PLY, OBJ, STL or GLB; all parts of a scene become one object.
        name: of the object; by default the file's stem.
        unit: "m", "cm", "mm", "inch", or "auto": a diameter of 0.02 to 1 means meters, of 20 to
            1000 millimeters.
        symmetries: (S, 4, 4) transforms in meters under which the object looks the same.
        diameter: meters; by default the largest distance between two vertices, from which it may
            differ by 10 %.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if the file is not a readable mesh, has no faces or NaN vertices, if its unit is
            ambiguous or its size implausible or not that of ``diameter``, or ``symmetries`` are not
            rigid transforms.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"mesh file {path} does not exist")
    if unit != "auto":
        check_unit(unit)
    given = None if symmetries is None else _check_symmetries(symmetries)
    state = path.stat()
    options = (name, unit, given, diameter)
    return import_cached(path.resolve(), *options, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=64)
def import_cached(
    path: Path,
    name: str | None,
    unit: str,
    symmetries: bytes | None,
    diameter: float | None,
    modified: int,
    size: int,
) -> ObjectModel:
    """Caches imports; ``modified`` and ``size`` are part of the key."""
    options = (name, unit, symmetries, diameter)
    key = mesh_key(path, (*options, MAX_FACES, TEXTURE_SIZE, CACHE_VERSION))
    model = cached(key, lambda: import_uncached(path, *options))
    # A size that is given, as in BOP's models_info.json, confirms the unit. Workers stay silent.
    if diameter is None and multiprocessing.parent_process() is None:
        print(f"{path.name}: {model.origin}")
    return model


CACHE_VERSION = 2
"""Increment it with every change to what `import_uncached` returns."""


def import_uncached(
    path: Path, name: str | None, unit: str, symmetries: bytes | None, diameter: float | None
) -> ObjectModel:
    """Imports without a cache."""
    parts = read_parts(path)
    meshes = [part.mesh for part in parts]
    _check_thickness(meshes, path)
    measured = surface.diameter(np.concatenate([m.vertices[np.unique(m.faces)] for m in meshes]))
    unit = resolve_unit(unit, measured, path)
    scale = METERS[unit]
    if diameter is not None and not 0.9 < measured * scale / diameter < 1.1:
        raise InputError(
            f"{path} has a diameter of {measured * scale:g} m, but diameter is given as "
            f"{diameter:g} m"
        )
    for part in meshes:
        part.apply_scale(scale)

    mesh = _weld(meshes)
    outward = mesh.is_winding_consistent and mesh.volume > 0
    if not outward:
        mesh.fix_normals()
    mesh = _decimate(mesh)
    points, normals, colors = sample_colors(parts)
    kinds = dict.fromkeys(part.paint.kind for part in parts if part.paint.kind)
    # Normals distinguish the two sides of a thin wall, if the file's are right.
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
        origin=f"read as {NAMES[unit]}, {length(measured * scale)} across, "
        + (", ".join(kinds) or "no colors (gray)"),
    )


def _check_thickness(meshes: list[trimesh.Trimesh], path: Path) -> None:
    corners = np.concatenate([mesh.triangles.reshape(-1, 3) for mesh in meshes])
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    if spread[2] <= 1e-6 * spread[0]:
        raise InputError(f"{path} is flat: an object needs some thickness")


def _weld(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Merges meshes and their duplicate vertices to one mesh."""
    vertices, faces = [mesh.vertices for mesh in meshes], [mesh.faces for mesh in meshes]
    mesh = trimesh.Trimesh(*trimesh.util.append_faces(vertices, faces))
    mesh.update_faces(mesh.unique_faces() & mesh.nondegenerate_faces(height=0.0))
    mesh.remove_unreferenced_vertices()
    return mesh


def _decimate(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Thins the mesh to ``MAX_FACES``."""
    if len(mesh.faces) <= MAX_FACES:
        return mesh
    for aggressiveness in (3.0, 5.0, 7.0):
        thinned = surface.simplified(mesh.vertices, mesh.faces, MAX_FACES, aggressiveness)
        decimated = trimesh.Trimesh(*thinned)
        decimated.update_faces(decimated.nondegenerate_faces(height=0.0))
        decimated.remove_unreferenced_vertices()
        if len(decimated.faces) <= MAX_FACES:
            break
    return decimated


def _number(stem: str) -> int:
    """BOP's number in names like obj_000005; otherwise a six-digit hash of the name."""
    match = re.fullmatch(r"obj_(\d+)", stem)
    return int(match[1]) if match else 100_000 + zlib.crc32(stem.encode()) % 900_000


def _check_symmetries(symmetries: np.ndarray) -> bytes:
    """Validates transforms (S, 4, 4); returns them, identity first, as hashable bytes."""
    array = np.asarray(symmetries, dtype=np.float64)
    if array.ndim != 3 or array.shape[1:] != (4, 4) or not len(array):
        raise InputError(f"symmetries must have the shape (S, 4, 4), got {array.shape}")
    checked = [check_rigid(T, f"symmetries[{i}]") for i, T in enumerate(array)]
    others = [T for T in checked if not np.allclose(T, np.eye(4), atol=1e-9)]
    return np.stack([np.eye(4), *others]).tobytes()
