"""Two-view pairs of a BOP dataset: which two pictures show objects that did not move between."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .bop_fields import MM, array, integer, read_json, required, rigid, transforms
from .geometry import invert

PAIRS_FILE = "two_view_pairs.json"
"""The list of pairs in a dataset's folder."""


@dataclass(frozen=True, eq=False)
class BopPair:
    """Two pictures of one scene between which the named objects did not move.

    Attributes:
        scene_id: number of the scene folder.
        ref_image_id: the reference view.
        second_image_id: the second view.
        T_second_ref: reference camera to second camera, (4, 4), metres.
        baselines_deg: for each object that stood still, the angle in degrees between the two rays
            from it to the cameras.
        target_obj_id: the object that the pair was made for, or None.
        gap: frames from one to the other where both belong to one sequence, or None.
        visib_fracts: for each object, its visible fractions in the reference view and in the
            second, 0 to 1; empty where the file does not say.
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
        """The objects that did not move."""
        return tuple(self.baselines_deg)

    @property
    def baseline_deg(self) -> float:
        """The angle at the target, or the mean over the objects where there is no target."""
        if self.target_obj_id is not None:
            return self.baselines_deg[self.target_obj_id]
        return float(np.mean(list(self.baselines_deg.values())))


def turned_round(pair: BopPair) -> BopPair:
    """The pair with its second view as the reference."""
    return replace(
        pair,
        ref_image_id=pair.second_image_id,
        second_image_id=pair.ref_image_id,
        T_second_ref=invert(pair.T_second_ref),
        visib_fracts={obj_id: (b, a) for obj_id, (a, b) in pair.visib_fracts.items()},
    )


def read_pairs(path: str | Path) -> tuple[BopPair, ...]:
    """Reads a list of two-view pairs.

    Two forms are known: ours (a list, see ``bop_writer.write_pairs``), and one for a single scene
    whose cameras have no world: ``{"scene_id", "pairs": [{"im_a", "im_b", "T_b_a_mm", "objects":
    {obj_id: {"baseline_deg"}}}]}``.

    Args:
        path: the file, or a dataset's folder that holds ``two_view_pairs.json``.

    Raises:
        ValueError: if the file is missing or broken; the message names file and field.
    """
    path = Path(path)
    if path.is_dir():
        path = path / PAIRS_FILE
    content = read_json(path, (list, dict))
    if isinstance(content, dict):
        return _read_worldless(content, str(path))
    places = [f"{path}: pair {i}" for i in range(len(content))]
    moves = transforms(content, "cam_R_ref2second", "cam_t_ref2second", places)
    return tuple(
        BopPair(
            scene_id=integer(required(entry, "scene_id", place), place),
            ref_image_id=integer(required(entry, "ref_image_id", place), place),
            second_image_id=integer(required(entry, "second_image_id", place), place),
            T_second_ref=T,
            baselines_deg=_baselines(required(entry, "baselines_deg", place), place),
            target_obj_id=entry.get("target_obj_id"),
            gap=_gap(entry, place),
            visib_fracts=_visib_fracts(entry.get("visib_fracts", {}), place),
        )
        for entry, place, T in zip(content, places, moves, strict=True)
    )


def _read_worldless(content: Mapping[str, Any], path: str) -> tuple[BopPair, ...]:
    scene_id = integer(required(content, "scene_id", path), path)
    pairs = required(content, "pairs", path)
    places = [f"{path}: pair {i}" for i in range(len(pairs))]
    moves = array(pairs, "T_b_a_mm", 16, places).reshape(-1, 4, 4)
    moves[:, :3, 3] /= MM
    moves = rigid(moves, [f"{place}: field 'T_b_a_mm'" for place in places])
    found = []
    for entry, place, T in zip(pairs, places, moves, strict=True):
        objects = required(entry, "objects", place)
        found.append(
            BopPair(
                scene_id=scene_id,
                ref_image_id=integer(required(entry, "im_a", place), place),
                second_image_id=integer(required(entry, "im_b", place), place),
                T_second_ref=T,
                baselines_deg=_baselines(
                    {k: required(v, "baseline_deg", place) for k, v in objects.items()}, place
                ),
                gap=_gap(entry, place),
            )
        )
    return tuple(found)


def _gap(entry: Mapping[str, Any], where: str) -> int | None:
    """The optional field ``gap``."""
    gap = entry.get("gap")
    if gap is None:
        return None
    if isinstance(gap, bool) or not isinstance(gap, int) or gap < 1:
        raise ValueError(f"{where}: field 'gap' must be an integer of at least 1, got {gap!r}")
    return gap


def _baselines(entry: Mapping[str, Any], where: str) -> dict[int, float]:
    return {
        integer(k, where): float(array([entry], k, 1, [f"{where}: baseline"])[0, 0]) for k in entry
    }


def _visib_fracts(entry: Mapping[str, Any], where: str) -> dict[int, tuple[float, float]]:
    """The optional field ``visib_fracts``."""
    place = f"{where}: visible fractions"
    return {
        integer(key, where): (float(both[0]), float(both[1]))
        for key in entry
        for both in array([entry], key, 2, [place])
    }
