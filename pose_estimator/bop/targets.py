"""Localization targets of a BOP test split: ``test_targets_bop19.json``."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from ...core.errors import InputError
from .dataset import BopDataset
from .fields import Place, read_ids, read_json
from .writer import write_json

TARGETS_FILE = "test_targets_bop19.json"

MIN_VISIBLE_FRACTION = 0.1
"""Visible fraction from which on an object is a target."""

_FIELDS = ("scene_id", "im_id", "obj_id", "inst_count")


class BopTarget(NamedTuple):
    """An object to localize in an image, and its number of instances there."""

    scene_id: int
    image_id: int
    obj_id: int
    instances: int


def is_test(split: str) -> bool:
    """Returns whether a split's name is that of a test split: ``test`` or ``test_TYPE``."""
    return split.split("_")[0] == "test"


def write_targets(dataset: BopDataset, scene_ids: Iterable[int] | None = None) -> None:
    """Writes the targets of a test split: its objects with a visible fraction of at least 0.1.

    Args:
        dataset: a test split.
        scene_ids: which of its scenes; None for all.
    """
    targets = _visible_targets(dataset, scene_ids)
    entries = [dict(sorted(zip(_FIELDS, target, strict=True))) for target in targets]
    write_json(Path(dataset.root) / TARGETS_FILE, entries)


def read_targets(dataset: BopDataset) -> tuple[BopTarget, ...]:
    """Returns the targets of a split.

    These are the entries of ``test_targets_bop19.json`` for a test split with that file, else the
    objects with a visible fraction of at least 0.1.

    Raises:
        InputError: if the file is invalid; the message names file and entry.
    """
    path = dataset.root / TARGETS_FILE
    if not (is_test(dataset.split) and path.is_file()):
        return tuple(_visible_targets(dataset))
    entries = read_json(path, list)
    places = [Place(entry=f"target {i}") for i in range(len(entries))]
    columns = [read_ids(entries, name, path, places).astype(int).tolist() for name in _FIELDS]
    targets = tuple(BopTarget(*numbers) for numbers in zip(*columns, strict=True))
    for i, target in enumerate(targets):
        if target.instances < 1:
            raise InputError(
                f"{path}: target {i}: field 'inst_count' must be >= 1, got {target.instances}"
            )
    return targets


def _visible_targets(
    dataset: BopDataset, scene_ids: Iterable[int] | None = None
) -> list[BopTarget]:
    targets = []
    for scene_id in dataset.scene_ids if scene_ids is None else scene_ids:
        for image_id, image in dataset.scene(scene_id).items():
            visible = (a.obj_id for a in image.annotations if a.visibility >= MIN_VISIBLE_FRACTION)
            for obj_id, count in sorted(Counter(visible).items()):
                targets.append(BopTarget(scene_id, image_id, obj_id, count))
    return targets
