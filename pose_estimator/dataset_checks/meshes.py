"""Reads a dataset's possibly invalid meshes and ``models_info.json``."""

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

SILHOUETTE_FACES = 600
"""Faces of a mesh that is decimated for silhouettes."""


@dataclass(eq=False)
class CheckedModel:
    """One object: its mesh and its entry of ``models_info.json``.

    Attributes:
        info: the entry; NaN where invalid.
        info_path: ``models_info.json``.
        mesh: as read, meters; None where it cannot be read.
        vertices: (V, 3) of the mesh decimated for silhouettes, meters.
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
        """Discrete symmetry transforms (S, 4, 4), identity first."""
        discrete = self.info.discrete
        good = discrete[~np.isnan(discrete).any(axis=(1, 2))]
        return np.concatenate([np.eye(4)[None], good])


def read_models(root: Path, findings: Findings) -> dict[int, CheckedModel]:
    """Returns obj_id -> object of ``models`` (or, without that folder, ``models_eval``)."""
    folders = [root / name for name in ("models", "models_eval") if (root / name).is_dir()]
    if not folders:
        findings.error(
            root / "models", "folder", "the dataset has no models",
            cause="BOP datasets have their models in a separate download (..._models.zip)",
            remedy="add models/obj_000001.ply and so on, and models/models_info.json",
        )  # fmt: skip
        return {}
    path = folders[0] / "models_info.json"
    infos = read_entries(path, findings.error)
    for mesh in sorted(folders[0].glob("obj_*.ply")):
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
    return CheckedModel(info, path, mesh, *_decimate(mesh), measured)


def _read_mesh(path: Path, report: Report) -> trimesh.Trimesh | None:
    """Returns the mesh in meters, or None."""
    if not path.is_file():
        report(
            path, "file", "an object has no mesh", detail=f"{path.name} is missing",
            remedy="restore the mesh, or remove the object from models_info.json",
        )  # fmt: skip
        return None
    try:
        mesh = trimesh.load_mesh(path, process=False)
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            raise InputError("no faces: a surface is needed, not points")
        if not np.isfinite(mesh.vertices).all():
            raise InputError("NaN or infinite coordinates")
        if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
            raise InputError("faces with invalid vertex indices")
        mesh.apply_scale(1 / MM)
        surface.diameter(np.asarray(mesh.vertices))
    except Exception as error:  # mesh readers raise any type of error for invalid files
        report(
            path, "file", "the mesh cannot be read",
            detail=" ".join(str(error).split())[:100] or type(error).__name__,
            cause="truncated, or exported without faces",
            remedy="export it again as a PLY with faces",
        )  # fmt: skip
        return None
    return mesh


def _decimate(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices and faces after quadric edge collapse."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) > SILHOUETTE_FACES:
        size = float(mesh.extents.max())  # the collapse's thresholds are lengths
        decimated, faces = fast_simplification.simplify(
            (vertices / size).astype(np.float32), faces, target_count=SILHOUETTE_FACES, agg=5.0
        )
        vertices = decimated.astype(np.float64) * size
    return vertices, np.asarray(faces)
