"""Two-view pairs of a BOP dataset: pairs of images between which objects did not move."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...core.geometry import invert
from .fields import (
    MAX_VISIBLE,
    MM,
    Place,
    Report,
    is_id,
    read_ids,
    read_json,
    read_numbers,
    read_transforms,
    refuse,
    rigid,
)

PAIRS_FILE = "two_view_pairs.json"
"""The list of pairs in a dataset's folder."""


@dataclass(frozen=True, eq=False)
class BopPair:
    """Two images of one scene between which the listed objects did not move.

    Attributes:
        ref_image_id: the reference view.
        second_image_id: the second view.
        T_second_ref: reference camera to second camera, (4, 4), meters.
        baselines_deg: obj_id -> angle in degrees between the two rays from a static object to the
            cameras.
        target_obj_id: the object that the pair was made for, or None.
        gap: number of frames between the views of a sequence, or None.
        visib_fracts: obj_id -> visible fractions in the reference and the second view, 0 to 1;
            empty where unknown.
    """

    scene_id: int
    ref_image_id: int
    second_image_id: int
    T_second_ref: np.ndarray
    baselines_deg: Mapping[int, float] = field(default_factory=dict)
    target_obj_id: int | None = None
    gap: int | None = None
    visib_fracts: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    @property
    def obj_ids(self) -> tuple[int, ...]:
        """Ids of the static objects."""
        return tuple(self.baselines_deg)

    @property
    def baseline_deg(self) -> float:
        """The angle at the target, or the mean over the objects where there is no target."""
        if self.target_obj_id is not None:
            return self.baselines_deg[self.target_obj_id]
        return float(np.mean(list(self.baselines_deg.values())))


def swapped(pair: BopPair) -> BopPair:
    """Returns the pair with its second view as the reference."""
    return replace(
        pair,
        ref_image_id=pair.second_image_id,
        second_image_id=pair.ref_image_id,
        T_second_ref=invert(pair.T_second_ref),
        visib_fracts={obj_id: (b, a) for obj_id, (a, b) in pair.visib_fracts.items()},
    )


def read_pairs(path: str | Path) -> tuple[BopPair, ...]:
    """Reads a list of two-view pairs.

    The file holds a list (see `writer.write_pairs`) or, for a single recorded scene, ``{"scene_id",
    "pairs": [{"im_a", "im_b", "T_b_a_mm", "objects": {obj_id: {"baseline_deg"}}}]}``.

    Args:
        path: the file, or a dataset's folder that holds ``two_view_pairs.json``.

    Raises:
        InputError: if the file is missing or invalid; the message names file and field.
    """
    path = Path(path)
    if path.is_dir():
        path = path / PAIRS_FILE
    pairs = read_entries(path)
    T = np.array([pair.T_second_ref for pair in pairs.values()]).reshape(-1, 4, 4)
    rigid(T, lambda i: f"{path}: pair {i}: rotation")
    return tuple(
        replace(pair, T_second_ref=moved) for pair, moved in zip(pairs.values(), T, strict=True)
    )


def read_entries(path: Path, report: Report = refuse) -> dict[int, BopPair]:
    """Returns position -> entry of a list of pairs, without entries that lack scene or image ids.

    Invalid transforms are NaN; rotations are not made orthonormal.

    Raises:
        InputError: by the default ``report``, where a field is invalid.
    """
    content = read_json(path, (list, dict), report)
    if content is None:
        return {}
    entries = content.get("pairs") if isinstance(content, dict) else content
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        report(
            path, "pairs", "must be a list of pairs",
            remedy="see bop.writer.write_pairs for the format",
        )  # fmt: skip
        return {}
    places = [Place(entry=f"pair {i}") for i in range(len(entries))]
    if isinstance(content, dict):
        entries = [_listed(content, entry) for entry in entries]
        T = read_numbers(entries, "T_b_a_mm", 16, path, places, report).reshape(-1, 4, 4)
        T[:, :3, 3] /= MM
    else:
        names = "cam_R_ref2second", "cam_t_ref2second"
        T = read_transforms(entries, names, path, places, report)
    ids = np.column_stack(
        [
            read_ids(entries, name, path, places, report)
            for name in ("scene_id", "ref_image_id", "second_image_id")
        ]
    )
    angles = [
        _baselines(entry.get("baselines_deg"), path, place, report)
        for entry, place in zip(entries, places, strict=True)
    ]
    return {
        number: BopPair(
            scene_id=int(ids[number, 0]),
            ref_image_id=int(ids[number, 1]),
            second_image_id=int(ids[number, 2]),
            T_second_ref=T[number],
            baselines_deg=angles[number],
            target_obj_id=_target(entry, angles[number], path, places[number], report),
            gap=_gap(entry.get("gap"), path, places[number], report),
            visib_fracts=_visib_fracts(entry, path, places[number], report),
        )
        for number, entry in enumerate(entries)
        if not np.isnan(ids[number]).any()
    }


def _listed(scene: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any]:
    """Returns an entry of a recorded scene with the names of an entry of the list."""
    names = {"im_a": "ref_image_id", "im_b": "second_image_id"}
    renamed = {"scene_id": scene.get("scene_id")}
    renamed |= {names.get(name, name): value for name, value in entry.items()}
    objects = entry.get("objects")
    if isinstance(objects, dict):
        renamed["baselines_deg"] = {
            key: value.get("baseline_deg") if isinstance(value, dict) else value
            for key, value in objects.items()
        }
    return renamed


def _target(
    entry: Mapping[str, Any], angles: Mapping[int, float], path: Path, place: Place, report: Report
) -> int | None:
    target = entry.get("target_obj_id")
    if target is None or (type(target) is int and target in angles):
        return target
    report(
        path, "target_obj_id", "must be one of baselines_deg", place=place,
        detail=f"{repr(target)[:60]}, of {', '.join(map(str, angles))}",
        remedy="write the id of the object that the pair was made for, or omit the field",
    )  # fmt: skip
    return None


def _gap(gap: Any, path: Path, place: Place, report: Report) -> int | None:
    if gap is None or (type(gap) is int and gap >= 1):
        return gap
    report(
        path, "gap", "must be an integer >= 1", place=place, detail=repr(gap)[:60],
        remedy="write the number of frames between the views, or omit the field",
    )  # fmt: skip
    return None


def _baselines(given: Any, path: Path, place: Place, report: Report) -> dict[int, float]:
    entries = given if isinstance(given, dict) else {}
    good = all(
        is_id(key) and isinstance(v, int | float) and 0 <= v <= 180 for key, v in entries.items()
    )
    if not entries or not good:
        report(
            path, "baselines_deg", "must map objects to angles",
            detail=f"{place}: {str(given)[:60]}",
            remedy="write the angle in degrees between the two views of each static object",
        )  # fmt: skip
        return {int(key): np.nan for key in entries if is_id(key)}
    return {int(key): float(value) for key, value in entries.items()}


def _visib_fracts(
    entry: Mapping[str, Any], path: Path, place: Place, report: Report
) -> dict[int, tuple[float, float]]:
    given = entry.get("visib_fracts", {})
    if not isinstance(given, dict) or not all(is_id(key) for key in given):
        report(
            path, "visib_fracts", "must map objects to visible fractions",
            detail=f"{place}: {str(given)[:60]}", remedy="see bop.writer.write_pairs",
        )  # fmt: skip
        return {}
    places = [Place(entry=f"{place}, visible fractions")]
    found = {int(key): read_numbers([given], key, 2, path, places, report)[0] for key in given}
    for obj_id, both in found.items():
        if ((both < 0) | (both > MAX_VISIBLE)).any():
            report(
                path, "visib_fracts", "must be 0 to 1", place=place,
                detail=f"object {obj_id}: {' '.join(f'{f:g}' for f in both)}",
                remedy="write the visible fractions in the reference and the second view",
            )  # fmt: skip
    return {i: (min(float(a), 1.0), min(float(b), 1.0)) for i, (a, b) in found.items()}
