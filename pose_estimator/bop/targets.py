"""What estimators are asked for in a BOP test split: ``test_targets_bop19.json``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from ...core.errors import InputError
from .dataset import BopDataset, BopImage
from .fields import Place, read_json, read_numbers
from .writer import write_json

TARGETS_FILE = "test_targets_bop19.json"

LEAST_VISIBLE = 0.1
"""Visible fraction from which on an object has to be found."""


class BopTarget(NamedTuple):
    """So many instances of an object are to be found in an image."""

    scene_id: int
    image_id: int
    obj_id: int
    instances: int


def is_test(split: str) -> bool:
    """Whether a split's name says that it is for testing: ``test`` or ``test_TYPE``."""
    return split.split("_")[0] == "test"


def write_targets(dataset: BopDataset, scene_ids: Iterable[int] | None = None) -> None:
    """Writes the list of targets into the dataset's folder.

    Each entry says how often an object is to be found in an image: ``scene_id``, ``im_id``,
    ``obj_id``, ``inst_count``. Only objects of which at least a tenth is visible count.

    Args:
        dataset: a test split.
        scene_ids: which of its scenes; None for all.
    """
    entries = [
        {
            "im_id": target.image_id,
            "inst_count": target.instances,
            "obj_id": target.obj_id,
            "scene_id": target.scene_id,
        }
        for target in _visible_targets(dataset, scene_ids)
    ]
    write_json(Path(dataset.root) / TARGETS_FILE, entries)


def read_targets(dataset: BopDataset) -> tuple[BopTarget, ...]:
    """What is to be found in a split.

    That is what ``test_targets_bop19.json`` lists, for a test split of a dataset that has such a
    file; else all of which at least a tenth is visible.

    Raises:
        InputError: if the file is broken; the message names file and entry.
    """
    path = dataset.root / TARGETS_FILE
    if not (is_test(dataset.split) and path.is_file()):
        return tuple(_visible_targets(dataset))
    entries = read_json(path, list)
    places = [Place(entry=f"target {i}") for i in range(len(entries))]
    columns = [
        read_numbers(entries, name, 1, path, places)[:, 0].astype(int).tolist()
        for name in ("scene_id", "im_id", "obj_id", "inst_count")
    ]
    targets = tuple(BopTarget(*numbers) for numbers in zip(*columns, strict=True))
    for i, target in enumerate(targets):
        if target.instances < 1:
            raise InputError(
                f"{path}: target {i}: field 'inst_count' must be at least 1, got {target.instances}"
            )
    return targets


def _visible_targets(
    dataset: BopDataset, scene_ids: Iterable[int] | None = None
) -> list[BopTarget]:
    return [
        BopTarget(image.scene_id, image.image_id, obj_id, count)
        for scene_id in (dataset.scene_ids if scene_ids is None else scene_ids)
        for image in dataset.scene(scene_id).values()
        for obj_id, count in _visible(image)
    ]


def _visible(image: BopImage) -> list[tuple[int, int]]:
    """Objects that can be seen and how many there are of each, by number."""
    seen = Counter(a.obj_id for a in image.annotations if a.visibility >= LEAST_VISIBLE)
    return sorted(seen.items())
