"""Reads ``models_info.json`` of a BOP dataset: sizes and symmetries of its objects."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .fields import MM, Place, Report, is_id, read_json, read_numbers, refuse, rigid
from .symmetries import MIN_AXIS_LENGTH, all_symmetries, axes_meet


@dataclass(frozen=True, eq=False)
class BopModelInfo:
    """One object's entry of ``models_info.json``.

    Attributes:
        name: its name, or None (not a field of BOP).
        diameter: largest distance between two surface points, meters.
        minimum: lower corner of the bounding box, (3,), meters.
        extents: sides of the bounding box, (3,), meters.
        discrete: (D, 4, 4) discrete symmetries without the identity, meters.
        axes: (C, 6) continuous symmetries: direction, and a point on the axis in meters.
        mesh_path: its PLY file (in millimeters).
    """

    obj_id: int
    name: str | None
    diameter: float
    minimum: np.ndarray
    extents: np.ndarray
    discrete: np.ndarray
    axes: np.ndarray
    mesh_path: Path

    @cached_property
    def symmetries(self) -> np.ndarray:
        """Symmetry transforms (S, 4, 4), identity first, meters; see `all_symmetries`."""
        return all_symmetries(self.discrete, self.axes)


def read_models_info(root: str | Path, folder: str = "models") -> dict[int, BopModelInfo]:
    """Reads ``models_info.json``: obj_id -> its entry.

    Raises:
        InputError: if the file is missing or invalid; the message names file and field.
    """
    path = Path(root) / folder / "models_info.json"
    infos = read_entries(path)
    for obj_id, info in infos.items():
        rigid(info.discrete, lambda i, o=obj_id: f"{path}: object {o}: symmetry {i}")  # type: ignore[misc]
    return infos


def read_entries(path: Path, report: Report = refuse) -> dict[int, BopModelInfo]:
    """Returns the entries of ``models_info.json``: invalid numbers are NaN, symmetries unchecked.

    Raises:
        InputError: by the default ``report``, where a field is invalid.
    """
    infos = {}
    for key, entry in (read_json(path, dict, report) or {}).items():
        if not is_id(key) or not isinstance(entry, dict):
            report(
                path, "keys", "an entry must be an object's id and its description",
                detail=f"key {key[:40]!r}", remedy="rename or remove the entry",
            )  # fmt: skip
            continue
        infos[int(key)] = _read_entry(int(key), entry, path, report)
    return infos


def _read_entry(obj_id: int, entry: Mapping[str, Any], path: Path, report: Report) -> BopModelInfo:
    place = Place(entry=f"object {obj_id}")

    def length(*names: str) -> np.ndarray:
        values = [read_numbers([entry], name, 1, path, [place], report)[0, 0] for name in names]
        return np.array(values) / MM

    def listed(name: str) -> list[Any]:
        value = entry.get(name, [])
        if isinstance(value, list):
            return value
        report(
            path, name, "must be a list", detail=f"object {obj_id}: {str(value)[:60]}",
            remedy="write a list, empty for none",
        )  # fmt: skip
        return []

    name = entry.get("name")
    if not isinstance(name, str | None):
        report(
            path, "name", "must be text", detail=f"object {obj_id}: {str(name)[:60]}",
            remedy="write the object's name, or remove the field",
        )  # fmt: skip
        name = None
    rows = [{"symmetries_discrete": row} for row in listed("symmetries_discrete")]
    places = [Place(entry=f"object {obj_id}, symmetry {i}") for i in range(len(rows))]
    discrete = read_numbers(rows, "symmetries_discrete", 16, path, places, report)
    discrete = discrete.reshape(-1, 4, 4)
    discrete[:, :3, 3] /= MM
    axes = _read_axes(listed("symmetries_continuous"), obj_id, path, report)
    diameter, extents = float(length("diameter")[0]), length("size_x", "size_y", "size_z")
    for field, wrong in (("diameter", diameter <= 0), ("size_x ... size_z", (extents < 0).any())):
        if wrong:
            report(
                path, field, "must be positive", place=place,
                remedy="write the lengths of the mesh in millimeters",
            )  # fmt: skip
    return BopModelInfo(
        obj_id=obj_id,
        name=name,
        diameter=diameter,
        minimum=length("min_x", "min_y", "min_z"),
        extents=extents,
        discrete=discrete,
        axes=axes,
        mesh_path=path.parent / f"obj_{obj_id:06d}.ply",
    )


def _read_axes(continuous: list[Any], obj_id: int, path: Path, report: Report) -> np.ndarray:
    """Returns axes (C, 6) of continuous symmetries; NaN where invalid."""
    name = "symmetries_continuous"
    places = [Place(entry=f"object {obj_id}, {name} {i}") for i in range(len(continuous))]
    axis = read_numbers(continuous, "axis", 3, path, places, report)
    offset = read_numbers(continuous, "offset", 3, path, places, report) / MM
    axes = np.concatenate([axis, offset], axis=1)
    for i in np.flatnonzero(np.linalg.norm(axis, axis=1) <= MIN_AXIS_LENGTH).tolist():
        report(
            path, name, "has no axis", place=places[i],
            detail=f"object {obj_id}, number {i}: axis {' '.join(f'{v:g}' for v in axis[i])}",
            cause="it was left empty", remedy="give a direction such as 0 0 1, or remove the entry",
        )  # fmt: skip
        axes[i] = np.nan
    if not axes_meet(axes[~np.isnan(axes).any(axis=1)]):
        report(
            path, name, "has axes that do not meet", place=Place(entry=f"object {obj_id}"),
            detail=f"object {obj_id}: {len(axes)} axes",
            cause="an offset is of another axis, or not in millimeters",
            remedy="give the points through which the axes pass; a sphere's meet in its center",
        )  # fmt: skip
        axes[1:] = np.nan
    return axes
