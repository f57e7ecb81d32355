"""What estimators are asked for in a BOP test split: ``test_targets_bop19.json``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from .bop import BopDataset, BopImage
from .bop_writer import write_json

TARGETS_FILE = "test_targets_bop19.json"

LEAST_VISIBLE = 0.1
"""Visible fraction from which on an object has to be found."""


def is_test(split: str) -> bool:
    """Whether a split's name says that it is for testing: ``test`` or ``test_TYPE``."""
    return split.split("_")[0] == "test"


def write_targets(dataset: BopDataset, scene_ids: Iterable[int] | None = None) -> None:
    """Writes the list of targets into the dataset's folder.

    Each entry says how often an object is to be found in a picture: ``scene_id``, ``im_id``,
    ``obj_id``, ``inst_count``. Only objects of which at least a tenth is visible count.

    Args:
        dataset: a test split.
        scene_ids: which of its scenes; None for all.
    """
    entries = [
        {
            "im_id": image.image_id,
            "inst_count": count,
            "obj_id": obj_id,
            "scene_id": image.scene_id,
        }
        for scene_id in (dataset.scene_ids if scene_ids is None else scene_ids)
        for image in dataset.scene(scene_id).values()
        for obj_id, count in _visible(image)
    ]
    write_json(Path(dataset.root) / TARGETS_FILE, entries)


def _visible(image: BopImage) -> list[tuple[int, int]]:
    """Objects that can be seen and how many there are of each, by number."""
    seen = Counter(a.obj_id for a in image.annotations if a.visibility >= LEAST_VISIBLE)
    return sorted(seen.items())
