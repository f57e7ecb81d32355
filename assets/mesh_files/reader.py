"""Reads and checks a mesh file of any type."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from ...core.errors import InputError
from .glb import read_glb
from .obj import read_obj
from .paint import unpainted
from .part import Part
from .ply import read_ply


def read_stl(path: Path, colors: bool) -> list[Part]:
    """Reads an STL file; the colors that some programs hide in it are not standard."""
    mesh = trimesh.load_mesh(path, process=False)
    return [Part(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), unpainted(str(path)))]


_READERS: dict[str, Callable[[Path, bool], list[Part]]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".glb": read_glb,
}

MESH_SUFFIXES = tuple(_READERS)
"""File types of `read_parts`."""


def read_parts(path: Path, *, colors: bool = True) -> list[Part]:
    """Reads all triangles of a mesh file, in its own frame and unit.

    Args:
        path: PLY, OBJ, STL or GLB.
        colors: False reads neither colors nor the files of materials and textures.

    Raises:
        InputError: if the file is not a readable mesh, has no faces or invalid numbers, or its
            colors, materials or textures are missing or cannot be understood.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"{path.name} must be one of {', '.join(MESH_SUFFIXES)}")
    try:
        parts = _READERS[path.suffix.lower()](path, colors)
        parts = [part for part in parts if len(part.mesh.faces)]
        for part in parts:
            _check_numbers(part.mesh, path)
            part.paint.check(len(part.mesh.vertices), len(part.mesh.faces))
    except InputError:
        raise
    except Exception as error:  # readers raise all kinds of errors
        raise InputError(f"{path} cannot be read as a mesh: {error!r}") from error
    if not parts:
        raise InputError(f"{path} has no faces: a surface is needed, not points")
    return parts


def _check_numbers(mesh: trimesh.Trimesh, path: Path) -> None:
    if mesh.vertices.ndim != 2 or mesh.vertices.shape[1] != 3:
        raise InputError(f"{path} has vertices of shape {mesh.vertices.shape}, not x, y and z")
    if not np.isfinite(mesh.vertices).all():
        bad = int((~np.isfinite(mesh.vertices).all(axis=1)).sum())
        raise InputError(f"{path} has NaN or infinite coordinates in {bad} vertices")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise InputError(f"{path} has faces with vertex indices out of range")
