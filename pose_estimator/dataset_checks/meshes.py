"""The meshes of a dataset that may be damaged, and what ``models_info.json`` says of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import fast_simplification
import numpy as np
import trimesh

from ...assets import surface
from ...core.errors import InputError
from ..bop.fields import MM, Report
from ..bop.models_info import BopModelInfo, read_entries
from .findings import Findings

LIGHT_FACES = 600
"""As many faces as a silhouette needs."""


@dataclass(eq=False)
class CheckedModel:
    """One object: what its mesh is, and what ``models_info.json`` says of it.

    Attributes:
        info: what the file says; NaN where it does not.
        info_path: ``models_info.json``.
        mesh: as read, meters; None where it cannot be read.
        vertices: (V, 3) of the mesh, meters, thinned out for silhouettes.
        faces: (F, 3).
        measured: diameter of the mesh, meters; NaN without one.
    """

    info: BopModelInfo
    info_path: Path
    mesh: trimesh.Trimesh | None
    vertices: np.ndarray
    faces: np.ndarray
    measured: float

    @property
    def obj_id(self) -> int:
        """Its number."""
        return self.info.obj_id

    @property
    def equivalents(self) -> np.ndarray:
        """Transforms (S, 4, 4) under which it looks the same, identity first, without axes."""
        discrete = self.info.discrete
        good = discrete[~np.isnan(discrete).any(axis=(1, 2))]
        return np.concatenate([np.eye(4)[None], good])


def read_models(root: Path, findings: Findings) -> dict[int, CheckedModel]:
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
    infos = read_entries(path, findings.error)
    for mesh in sorted(folder.glob("obj_*.ply")):
        number = mesh.stem.removeprefix("obj_")
        if infos and number.isdigit() and int(number) not in infos:
            findings.warning(
                path, "keys", "a mesh is not described", detail=mesh.name,
                remedy="add its diameter, minimum and size to models_info.json",
            )  # fmt: skip
    return {obj_id: _read_model(info, path, findings.error) for obj_id, info in infos.items()}


def _read_model(info: BopModelInfo, path: Path, report: Report) -> CheckedModel:
    mesh = _read_mesh(info.mesh_path, report)
    if mesh is None:
        return CheckedModel(info, path, None, np.empty((0, 3)), np.empty((0, 3), np.int32), np.nan)
    measured = surface.diameter(np.asarray(mesh.vertices))
    return CheckedModel(info, path, mesh, *_lighten(mesh), measured)


def _read_mesh(path: Path, report: Report) -> trimesh.Trimesh | None:
    """The mesh in meters, or None."""
    if not path.is_file():
        report(
            path, "file", "an object has no mesh", detail=f"{path.name} is missing",
            remedy="restore the mesh, or take the object out of models_info.json",
        )  # fmt: skip
        return None
    try:
        mesh = trimesh.load_mesh(path, process=False)
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            raise InputError("no faces: a surface is needed, not points")
        if not np.isfinite(mesh.vertices).all():
            raise InputError("NaN or infinite coordinates")
        if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
            raise InputError("faces with vertices that it does not have")
        mesh.apply_scale(1 / MM)
        surface.diameter(np.asarray(mesh.vertices))
    except Exception as error:  # readers of broken files fail in every way there is
        report(
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
