"""The objects of a BOP dataset for evaluation: points, diameters, symmetries."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ... import assets
from ...assets import surface
from ...assets.mesh_files import open_ply
from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from .fields import MM
from .models_info import BopModelInfo, read_models_info

_FOLDERS = ("models_eval", "models")

PLAUSIBLE_DIAMETERS = (0.003, 5.0)
"""Range of objects' diameters in meters; others are in another unit."""

SAME_DIAMETER = 0.1
"""Relative difference within which two diameters are those of one object."""


@dataclass(frozen=True, eq=False)
class EvaluationObject:
    """One object of a dataset, geometry only.

    Attributes:
        name: its name, or ``obj_000005`` where the dataset has none.
        points: (N, 3) the vertices of its mesh, meters, as bop_toolkit uses.
        diameter: largest distance between two surface points, meters.
        symmetries: (S, 4, 4) symmetry transforms, identity first, meters.
    """

    obj_id: int
    name: str
    points: np.ndarray
    diameter: float
    symmetries: np.ndarray

    @property
    def symmetric(self) -> bool:
        """Whether the object's error is ADD-S instead of ADD."""
        return len(self.symmetries) > 1


def load_objects(
    spec: str | Path | Iterable[str | Path] | None = None,
    unit: str = "auto",
) -> dict[str, ObjectModel]:
    """`assets.load_objects` that also reads ``models_info.json`` of BOP datasets.

    A mesh ``obj_000005.ply`` in a folder with that file is in millimeters, and its symmetries,
    diameter and name come from the file.

    Args:
        spec: as of `assets.load_objects`.
        unit: of all other meshes, see ``core.units``.

    Raises:
        InputError: as `assets.load_objects`, or if ``models_info.json`` is invalid or its diameter
            is not that of the mesh.
        FileNotFoundError: as `assets.load_objects`.
    """
    return assets.load_objects(spec, partial(_load_object, unit=unit))


def _load_object(name_or_path: str | Path, unit: str) -> ObjectModel:
    name, path = assets.split_name(name_or_path)
    folder = path.resolve().parent
    info_path = folder / "models_info.json"
    if not (re.fullmatch(r"obj_\d+", path.stem) and path.is_file() and info_path.is_file()):
        return assets.load_object(name_or_path, unit)
    info = read_models_info(folder.parent, folder.name).get(int(path.stem.removeprefix("obj_")))
    if info is None:
        return assets.load_object(name_or_path, unit)
    if unit not in ("auto", "mm"):
        raise InputError(
            f"{path} is described by {info_path}, so that it is in millimeters: leave out the unit "
            f"{unit!r}, or copy the mesh to another folder"
        )
    from ...assets.mesh_import import import_mesh

    name, symmetries = name or info.name, info.symmetries
    try:
        return import_mesh(path, name, unit="mm", symmetries=symmetries, diameter=info.diameter)
    except ValueError as error:
        raise InputError(f"{error}; see {info_path}") from error


def has_models(root: str | Path) -> bool:
    """Returns whether a dataset has models of its objects."""
    return any((Path(root) / name).is_dir() for name in _FOLDERS)


def info_folder(root: str | Path) -> str:
    """Returns the folder of the ``models_info.json`` by which errors are measured."""
    return next((n for n in _FOLDERS if (Path(root) / n / "models_info.json").is_file()), "models")


def dataset_objects(
    root: str | Path, obj_ids: Collection[int] | None = None, *, ignore_unknown: bool = False
) -> dict[int, EvaluationObject]:
    """Returns a dataset's objects for evaluation: those of ``models_eval``, else of ``models``.

    Diameters and symmetries come from the folder's ``models_info.json``, else from that of
    ``models``.

    Args:
        root: the dataset's folder.
        obj_ids: which to read; None for all.
        ignore_unknown: skip those that ``models_info.json`` does not describe.

    Returns:
        obj_id -> object, ascending.

    Raises:
        InputError: if there are no models, one is missing or invalid, its diameter is implausible,
            or not that of ``models_info.json``, or the two folders have different diameters.
    """
    root = Path(root)
    folder = next((name for name in _FOLDERS if (root / name).is_dir()), None)
    if folder is None:
        others = ", ".join(sorted(path.name for path in root.glob("models_*") if path.is_dir()))
        hint = f"rename one of its folders {others}" if others else "extract its models there"
        raise InputError(f"{root} has neither models_eval nor models: {hint}")
    infos = read_models_info(root, info_folder(root))
    wanted = sorted(infos if obj_ids is None else set(obj_ids))
    if ignore_unknown:
        wanted = [obj_id for obj_id in wanted if obj_id in infos]
    if unknown := [obj_id for obj_id in wanted if obj_id not in infos]:
        path = root / info_folder(root) / "models_info.json"
        raise InputError(
            f"{path} does not describe object {unknown[0]}; it has "
            f"{', '.join(map(str, sorted(infos)))}"
        )
    found = {i: _object(infos[i], root / folder / infos[i].mesh_path.name) for i in wanted}
    if info_folder(root) == "models_eval" and (root / "models" / "models_info.json").is_file():
        _compare_diameters(root, infos, wanted)
    return found


def _compare_diameters(root: Path, infos: Mapping[int, BopModelInfo], wanted: list[int]) -> None:
    """Raises where ``models_eval`` and ``models`` have different diameters of one object."""
    others = read_models_info(root)
    for obj_id in wanted:
        if obj_id not in others:
            continue
        measured, other = infos[obj_id].diameter, others[obj_id].diameter
        if not abs(measured / other - 1) <= SAME_DIAMETER:
            raise InputError(
                f"object {obj_id} is {measured * MM:g} mm across in {root / 'models_eval'}, and "
                f"{other * MM:g} mm in models; both must be in millimeters, see check-data"
            )


def _object(info: BopModelInfo, path: Path) -> EvaluationObject:
    points = _read_vertices(path)
    measured = surface.diameter(points)
    if not abs(measured / info.diameter - 1) < SAME_DIAMETER:
        raise InputError(
            f"{path} has a diameter of {measured * MM:g} mm, but models_info.json says "
            f"{info.diameter * MM:g} mm; both must be in millimeters"
        )
    low, high = PLAUSIBLE_DIAMETERS
    if not low <= measured <= high:
        unit = "meters" if measured < low else "another unit"
        raise InputError(
            f"{path} is {measured * MM:g} mm across, read as millimeters; it seems to be in "
            f"{unit}: scale its vertices and models_info.json to millimeters, see check-data"
        )
    return EvaluationObject(
        obj_id=info.obj_id,
        name=info.name or f"obj_{info.obj_id:06d}",
        points=points,
        diameter=info.diameter,
        symmetries=info.symmetries,
    )


def _read_vertices(path: Path) -> np.ndarray:
    """Returns the vertices (N, 3) of a PLY file, meters."""
    if not path.is_file():
        raise InputError(f"{path} is missing, but models_info.json describes that object")
    try:
        # Vertices as stored, of clouds without faces too.
        mesh: Any = trimesh.load(
            open_ply(path)[0], file_type="ply", process=False, fix_texture=False,
            skip_materials=True,
        )  # fmt: skip
        vertices = np.asarray(mesh.vertices, dtype=np.float64) / MM
    except Exception as error:  # mesh readers raise any type of error for invalid files
        raise InputError(f"{path} cannot be read as a mesh (truncated?): {error!r}") from error
    if vertices.ndim != 2 or len(vertices) < 4 or not np.isfinite(vertices).all():
        raise InputError(f"{path} must hold at least four vertices, all of them finite")
    return vertices
