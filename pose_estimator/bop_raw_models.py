"""The models of a BOP dataset that may be damaged: what can be read, and findings for the rest.

One more of the places that know of millimetres on the disk: all that it returns is in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fast_simplification
import numpy as np
import trimesh

from ..assets import surface
from .bop_fields import MM
from .bop_raw_fields import read_numbers, read_raw_json
from .data_findings import Findings, Place

LIGHT_FACES = 600
"""As many faces as a silhouette needs."""


@dataclass(eq=False)
class RawModel:
    """One object: what its mesh is, and what ``models_info.json`` says of it.

    Attributes:
        obj_id: its number.
        path: the mesh file.
        info_path: ``models_info.json``.
        mesh: as read, metres; None where it cannot be read.
        vertices: (V, 3) of the mesh, thinned out for silhouettes.
        faces: (F, 3).
        measured: diameter of the mesh, metres; NaN without one.
        diameter: what the file says, metres; NaN where it does not.
        minimum: (3,) what the file says.
        extents: (3,) what the file says.
        symmetries: (S, 4, 4) the file's discrete symmetries; rows of NaN where broken.
        axes: (C, 6) the file's continuous symmetries: axis and offset.
    """

    obj_id: int
    path: Path
    info_path: Path
    mesh: trimesh.Trimesh | None
    vertices: np.ndarray
    faces: np.ndarray
    measured: float
    diameter: float
    minimum: np.ndarray
    extents: np.ndarray
    symmetries: np.ndarray
    axes: np.ndarray

    @property
    def equivalents(self) -> np.ndarray:
        """Transforms (S, 4, 4) under which it looks the same, identity first, without axes."""
        good = self.symmetries[~np.isnan(self.symmetries).any(axis=(1, 2))]
        return np.concatenate([np.eye(4)[None], good])


def read_raw_models(root: Path, findings: Findings) -> dict[int, RawModel]:
    """All objects of ``models`` (or, without that folder, ``models_eval``), by number."""
    folder = root / "models"
    if not folder.is_dir() and (root / "models_eval").is_dir():
        folder = root / "models_eval"
    if not folder.is_dir():
        findings.error(
            folder, "folder", "the dataset has no models",
            cause="the models of a BOP dataset are a download of their own (..._models.zip)",
            remedy="put models/obj_000001.ply and so on, and models/models_info.json, here",
        )  # fmt: skip
        return {}
    path = folder / "models_info.json"
    infos = read_raw_json(path, dict, findings) or {}
    models = {}
    for key, entry in infos.items():
        if not key.isdigit() or not isinstance(entry, dict):
            findings.error(
                path, "keys", "an entry must be an object's number and its description",
                detail=f"key {key[:40]!r}", remedy="rename or remove the entry",
            )  # fmt: skip
            continue
        models[int(key)] = _read_model(int(key), entry, path, findings)
    for mesh in sorted(folder.glob("obj_*.ply")):
        number = mesh.stem.removeprefix("obj_")
        if infos and number.isdigit() and int(number) not in models:
            findings.warning(
                path, "keys", "a mesh is not described", detail=mesh.name,
                remedy="add its diameter, minimum and size to models_info.json",
            )  # fmt: skip
    return models


def _read_model(obj_id: int, entry: Mapping[str, Any], path: Path, findings: Findings) -> RawModel:
    where = [Place()]

    def numbers(name: str) -> float:
        return float(read_numbers([entry], name, 1, path, where, findings)[0, 0]) / MM

    def listed(name: str) -> list[Any]:
        value = entry.get(name, [])
        if isinstance(value, list):
            return value
        findings.error(
            path, name, "must be a list", detail=f"object {obj_id}: {str(value)[:60]}",
            remedy="give a list, empty for none",
        )  # fmt: skip
        return []

    discrete = listed("symmetries_discrete")
    rows = [{"symmetries_discrete": row} for row in discrete]
    symmetries = read_numbers(
        rows, "symmetries_discrete", 16, path, where * len(rows), findings
    ).reshape(-1, 4, 4)
    symmetries[:, :3, 3] /= MM
    continuous = listed("symmetries_continuous")
    places = where * len(continuous)
    axes = np.concatenate(
        [
            read_numbers(continuous, "axis", 3, path, places, findings),
            read_numbers(continuous, "offset", 3, path, places, findings) / MM,
        ],
        axis=1,
    )
    mesh_path = path.parent / f"obj_{obj_id:06d}.ply"
    mesh = _read_mesh(mesh_path, findings)
    vertices, faces, measured = np.empty((0, 3)), np.empty((0, 3), np.int32), np.nan
    if mesh is not None:
        vertices, faces = _lighten(mesh)
        measured = surface.diameter(np.asarray(mesh.vertices))
    return RawModel(
        obj_id=obj_id,
        path=mesh_path,
        info_path=path,
        mesh=mesh,
        vertices=vertices,
        faces=faces,
        measured=measured,
        diameter=numbers("diameter"),
        minimum=np.array([numbers(f"min_{axis}") for axis in "xyz"]),
        extents=np.array([numbers(f"size_{axis}") for axis in "xyz"]),
        symmetries=symmetries,
        axes=axes,
    )


def _read_mesh(path: Path, findings: Findings) -> trimesh.Trimesh | None:
    """The mesh in metres, or None."""
    if not path.is_file():
        findings.error(
            path, "file", "an object has no mesh", detail=f"{path.name} is missing",
            remedy="restore the mesh, or take the object out of models_info.json",
        )  # fmt: skip
        return None
    try:
        mesh = trimesh.load_mesh(path, process=False)
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            raise ValueError("no faces: a surface is needed, not points")
        if not np.isfinite(mesh.vertices).all():
            raise ValueError("NaN or infinite coordinates")
        if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
            raise ValueError("faces with vertices that it does not have")
        mesh.apply_scale(1 / MM)
        surface.diameter(np.asarray(mesh.vertices))
    except Exception as error:  # readers of broken files fail in every way there is
        findings.error(
            path, "file", "the mesh cannot be read",
            detail=" ".join(str(error).split())[:100] or type(error).__name__,
            cause="truncated, or exported without faces",
            remedy="export it anew as a PLY with faces",
        )  # fmt: skip
        return None
    return mesh


def _lighten(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces, thinned out by quadric edge collapse."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) > LIGHT_FACES:
        size = float(mesh.extents.max())  # the collapse's thresholds are lengths
        light, faces = fast_simplification.simplify(
            (vertices / size).astype(np.float32), faces, target_count=LIGHT_FACES, agg=5.0
        )
        vertices = light.astype(np.float64) * size
    return vertices, np.asarray(faces)
