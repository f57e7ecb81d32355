"""Lists of two-view pairs that may be damaged: what can be read, and findings for the rest.

One more of the places that know of millimetres on the disk: all that it returns is in metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .bop_fields import MM
from .bop_raw_fields import read_numbers, read_raw_json
from .data_findings import Findings, Place


@dataclass(frozen=True, eq=False)
class RawPair:
    """One entry of a file of pairs.

    Attributes:
        number: its place in the file.
        scene_id: of its pictures.
        first: the reference view.
        second: the second view.
        T_second_ref: (4, 4), metres; NaN where it is broken.
        obj_ids: the objects that stood still.
    """

    number: int
    scene_id: int
    first: int
    second: int
    T_second_ref: np.ndarray
    obj_ids: tuple[int, ...]


def read_raw_pairs(path: Path, findings: Findings) -> list[RawPair]:
    """All pairs of a file that can be read, in either form that `bop_pairs` knows."""
    content = read_raw_json(path, (list, dict), findings)
    recorded = isinstance(content, dict)
    entries: Any = content.get("pairs") if isinstance(content, dict) else content
    if content is None:
        return []
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        findings.error(
            path,
            "pairs",
            "must be a list of pairs",
            remedy="see bop_writer.write_pairs for the form",
        )
        return []
    if not entries:
        findings.warning(
            path,
            "pairs",
            "there are none",
            remedy="remove the file: pairs are then found",
        )
    places = [Place()] * len(entries)
    T = np.tile(np.eye(4), (len(entries), 1, 1))
    if recorded:
        entries = [{"scene_id": content.get("scene_id")} | entry for entry in entries]
        T = read_numbers(entries, "T_b_a_mm", 16, path, places, findings).reshape(-1, 4, 4)
    else:
        T[:, :3, :3] = read_numbers(entries, "cam_R_ref2second", 9, path, places, findings).reshape(
            -1, 3, 3
        )
        T[:, :3, 3] = read_numbers(entries, "cam_t_ref2second", 3, path, places, findings)
    T[:, :3, 3] /= MM
    names = ("scene_id", *(("im_a", "im_b") if recorded else ("ref_image_id", "second_image_id")))
    columns = [read_numbers(entries, name, 1, path, places, findings)[:, 0] for name in names]
    pairs = []
    for number, entry in enumerate(entries):
        objects = entry.get("objects" if recorded else "baselines_deg")
        if any(np.isnan(column[number]) for column in columns):
            continue
        ids = _objects(objects, path, number, findings)
        scene_id, first, second = (int(column[number]) for column in columns)
        pairs.append(RawPair(number, scene_id, first, second, T[number], ids))
    return pairs


def _objects(given: Any, path: Path, number: int, findings: Findings) -> tuple[int, ...]:
    """The objects of a pair, from their baselines."""
    entries = given if isinstance(given, dict) else {}
    values = {
        key: value.get("baseline_deg") if isinstance(value, dict) else value
        for key, value in entries.items()
    }
    good = all(
        key.isdigit() and isinstance(v, int | float) and 0 <= v <= 180 for key, v in values.items()
    )
    if not entries or not good:
        findings.error(
            path, "baselines_deg", "must be objects and their angles",
            detail=f"pair {number}: {str(given)[:60]}",
            remedy="give each object that stood still the angle in degrees between its two views",
        )  # fmt: skip
    return tuple(int(key) for key in entries if key.isdigit())
