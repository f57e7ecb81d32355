"""Reads a dataset's possibly invalid meshes and ``models_info.json``."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from ...assets import surface
from ...assets.mesh_files import Part, read_parts
from ...core.errors import InputError
from ..bop.fields import MM
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
        part: the mesh and its colors as read, meters; None where it cannot be read.
        vertices: (V, 3) of the mesh decimated for silhouettes, meters.
        faces: (F, 3).
        measured: diameter of the mesh, meters; NaN without one.
    """

    info: BopModelInfo
    info_path: Path
    part: Part | None
    vertices: np.ndarray
    faces: np.ndarray
    measured: float

    @property
    def obj_id(self) -> int:
        """Its number."""
        return self.info.obj_id

    @property
    def mesh(self) -> trimesh.Trimesh | None:
        """Its triangles, meters; None where they cannot be read."""
        return None if self.part is None else self.part.mesh

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
    return {obj_id: _read_model(info, path, findings) for obj_id, info in infos.items()}


def _read_model(info: BopModelInfo, path: Path, findings: Findings) -> CheckedModel:
    part = _read_part(info.mesh_path, findings)
    if part is None:
        return CheckedModel(info, path, None, np.empty((0, 3)), np.empty((0, 3), np.int32), np.nan)
    mesh = part.mesh
    measured = surface.diameter(np.asarray(mesh.vertices))
    thinned = surface.simplified(mesh.vertices, mesh.faces, SILHOUETTE_FACES, aggressiveness=5.0)
    return CheckedModel(info, path, part, *thinned, measured)


def _read_part(path: Path, findings: Findings) -> Part | None:
    """Returns the mesh in meters with its colors, or None."""
    if not path.is_file():
        findings.error(
            path, "file", "an object has no mesh", detail=f"{path.name} is missing",
            remedy="restore the mesh, or remove the object from models_info.json",
        )  # fmt: skip
        return None
    unreadable = ""
    try:
        try:
            (part,) = read_parts(path)
        except InputError as error:
            unreadable = " ".join(str(error).split())
            (part,) = read_parts(path, colors=False)
        part.mesh.apply_scale(1 / MM)
        surface.diameter(np.asarray(part.mesh.vertices))
    except Exception as error:  # what reads and measures meshes raises all kinds of errors
        findings.error(
            path, "file", "the mesh cannot be read",
            detail=" ".join(str(error).split())[:100] or type(error).__name__,
            cause="truncated, or exported without faces",
            remedy="export it again as a PLY with faces",
        )  # fmt: skip
        return None
    if unreadable:
        findings.warning(
            path, "colors", "the colors of the mesh cannot be read", detail=unreadable,
            cause="a texture that is missing or damaged",
            remedy="restore it: generate and train-estimator refuse this mesh",
        )  # fmt: skip
    return part
