"""``models_info.json`` of a BOP dataset: the sizes and the symmetries of its objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .bop_fields import MM, array, integer, read_json, rigid

CONTINUOUS_SYMMETRY_STEPS = 72
"""How many rotations stand for a continuous symmetry."""


@dataclass(frozen=True, eq=False)
class BopModelInfo:
    """What ``models_info.json`` says of one object.

    Attributes:
        obj_id: its number.
        name: its name, or None (the field is not part of BOP).
        diameter: largest distance between two surface points, metres.
        minimum: lower corner of the bounding box, (3,), metres.
        extents: sides of the bounding box, (3,), metres.
        symmetries: (S, 4, 4) transforms under which it looks the same, identity first, metres.
        mesh_path: its PLY file (in millimetres).
    """

    obj_id: int
    name: str | None
    diameter: float
    minimum: np.ndarray
    extents: np.ndarray
    symmetries: np.ndarray
    mesh_path: Path


def read_models_info(root: str | Path, folder: str = "models") -> dict[int, BopModelInfo]:
    """Reads ``models_info.json``: obj_id -> what it says, in metres.

    Continuous symmetries arrive as ``CONTINUOUS_SYMMETRY_STEPS`` discrete ones.

    Raises:
        ValueError: if the file is missing or broken; the message names file and field.
    """
    path = Path(root) / folder / "models_info.json"
    infos = {}
    for key, entry in read_json(path, dict).items():
        where = f"{path}: object {key}"
        minimum, extents = (
            np.array([array([entry], f"{part}_{axis}", 1, [where])[0, 0] for axis in "xyz"]) / MM
            for part in ("min", "size")
        )
        obj_id = integer(key, where)
        infos[obj_id] = BopModelInfo(
            obj_id=obj_id,
            name=entry.get("name"),
            diameter=float(array([entry], "diameter", 1, [where])[0, 0]) / MM,
            minimum=minimum,
            extents=extents,
            symmetries=_symmetries(entry, where),
            mesh_path=path.parent / f"obj_{obj_id:06d}.ply",
        )
    return infos


def _symmetries(entry: Mapping[str, Any], where: str) -> np.ndarray:
    """The symmetry transforms of one model (S, 4, 4), identity first, metres."""
    given = entry.get("symmetries_discrete", [])
    places = [f"{where}: symmetry {i}" for i in range(len(given))]
    rows = [{"symmetries_discrete": row} for row in given]
    discrete = array(rows, "symmetries_discrete", 16, places).reshape(-1, 4, 4)
    discrete[:, :3, 3] /= MM
    found = [np.eye(4), *rigid(discrete, places)]
    for symmetry in entry.get("symmetries_continuous", []):
        axis = array([symmetry], "axis", 3, [where])[0]
        offset = array([symmetry], "offset", 3, [where])[0] / MM
        angles = np.linspace(0, 2 * np.pi, CONTINUOUS_SYMMETRY_STEPS, endpoint=False)[1:]
        turns = np.tile(np.eye(4), (len(angles), 1, 1))
        turns[:, :3, :3] = Rotation.from_rotvec(
            angles[:, None] * axis / np.linalg.norm(axis)
        ).as_matrix()
        turns[:, :3, 3] = offset - turns[:, :3, :3] @ offset
        found = [*found, *(T @ turn for T in found for turn in turns)]
    return np.stack(found)
