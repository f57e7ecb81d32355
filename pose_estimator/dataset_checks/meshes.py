"""Reads a dataset's possibly invalid meshes and ``models_info.json``, in both folders."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from ...assets import surface
from ...assets.mesh_files import Part, open_ply, read_parts, unpainted
from ...core.errors import InputError
from ..bop.fields import MM, is_id
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
    def bounds(self) -> np.ndarray:
        """Lower and upper corner of the mesh's bounding box, (2, 3), meters."""
        if self.mesh is None:
            return np.full((2, 3), np.nan)
        if len(self.mesh.faces):
            return np.asarray(self.mesh.bounds)
        return np.stack([self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)])

    @property
    def equivalents(self) -> np.ndarray:
        """Discrete symmetry transforms (S, 4, 4), identity first."""
        discrete = self.info.discrete
        good = discrete[~np.isnan(discrete).any(axis=(1, 2))]
        return np.concatenate([np.eye(4)[None], good])


MODELS, EVALUATION = "models", "models_eval"
"""Folders of the meshes with colors, and of those on which errors are measured."""


def read_models(root: Path, findings: Findings) -> dict[str, dict[int, CheckedModel]]:
    """Returns folder -> obj_id -> object, of ``models`` and of ``models_eval``."""
    folders = [root / name for name in (MODELS, EVALUATION) if (root / name).is_dir()]
    if not folders:
        others = sorted(path.name for path in root.glob("models_*") if path.is_dir())
        cause = f"the models are in {', '.join(others)}" if others else (
            "BOP datasets have their models in a separate download (..._models.zip)"
        )  # fmt: skip
        findings.warning(
            root / MODELS, "folder", "the dataset has no models", cause=cause,
            remedy="add models/obj_000001.ply and so on, and models/models_info.json",
        )  # fmt: skip
    return {folder.name: _read_folder(folder, findings) for folder in folders}


def _read_folder(folder: Path, findings: Findings) -> dict[int, CheckedModel]:
    """Returns obj_id -> object of one folder of models."""
    path = folder / "models_info.json"
    described = folder.parent / MODELS / path.name
    if folder.name == EVALUATION and not path.is_file() and described.is_file():
        path = described  # it is reported with that folder
        infos = {
            obj_id: replace(info, mesh_path=folder / info.mesh_path.name)
            for obj_id, info in read_entries(path, Findings().error).items()
        }
    else:
        infos = read_entries(path, findings.error)
    for mesh in sorted(folder.glob("obj_*.ply")):
        number = mesh.stem.removeprefix("obj_")
        if infos and is_id(number) and int(number) not in infos:
            findings.warning(
                path, "keys", "a mesh is not described", detail=f"{folder.name}/{mesh.name}",
                remedy="add its diameter, minimum and size to models_info.json",
            )  # fmt: skip
    # Errors need the vertices only.
    faces = folder.name != EVALUATION or not (folder.parent / MODELS).is_dir()
    return {
        obj_id: _read_model(info, path, findings, faces=faces) for obj_id, info in infos.items()
    }


def _read_model(info: BopModelInfo, path: Path, findings: Findings, *, faces: bool) -> CheckedModel:
    part = _read_part(info.mesh_path, findings, faces=faces)
    if part is None:
        return CheckedModel(info, path, None, np.empty((0, 3)), np.empty((0, 3), np.int32), np.nan)
    mesh = part.mesh
    measured = surface.diameter(np.asarray(mesh.vertices))
    thinned = surface.simplified(mesh.vertices, mesh.faces, SILHOUETTE_FACES, aggressiveness=5.0)
    return CheckedModel(info, path, part, *thinned, measured)


def _read_part(path: Path, findings: Findings, *, faces: bool) -> Part | None:
    """Returns the mesh in meters with its colors, or None.

    Points alone are an error if ``faces``.
    """
    if not path.is_file():
        findings.error(
            path, "file", "an object has no mesh", detail=f"{path.name} is missing",
            remedy="restore the mesh, or remove the object from models_info.json",
        )  # fmt: skip
        return None
    unreadable = ""
    try:
        try:
            part = _only_part(path, faces=faces, colors=True)
        except InputError as error:
            unreadable = " ".join(str(error).split())
            part = _only_part(path, faces=faces, colors=False)
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


def _only_part(path: Path, *, faces: bool, colors: bool) -> Part:
    try:
        (part,) = read_parts(path, colors=colors)
    except InputError:
        cloud = None if faces else trimesh.load(open_ply(path)[0], file_type="ply")
        if not isinstance(cloud, trimesh.PointCloud) or not np.isfinite(cloud.vertices).all():
            raise
        part = Part(trimesh.Trimesh(cloud.vertices, process=False), unpainted(str(path)))
    return part
