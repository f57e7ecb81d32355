"""Which objects a training is of: those that are asked for, or those that the dataset shows."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ... import assets
from ...assets.object_model import ObjectModel
from ..bop.models_info import BopModelInfo, read_models_info
from ..bop.objects import load_objects

_SAME = 1e-4
"""Meters within which the bounding boxes of one model agree."""


def training_objects(data: Path, objects: Sequence[str]) -> dict[str, ObjectModel]:
    """The objects of a training, by name.

    Args:
        data: the dataset.
        objects: what was asked for, names and meshes. Where that is nothing and the dataset was
            made of other objects than our thirteen, its own models are taken; else our thirteen.

    Raises:
        InputError: if a model cannot be read.
        FileNotFoundError: if a mesh is missing.
    """
    if objects:
        return load_objects(list(objects))
    own = own_models(data)
    if own is None:
        return assets.load_objects(None)
    models = load_objects(own)
    print(f"objects of {data / 'models'}: {', '.join(models)}")
    return models


def own_models(data: Path) -> list[str] | None:
    """The models of a dataset, for ``load_objects``, without those that only stood around.

    Returns:
        None where they are all of our thirteen, or the dataset has no models.
    """
    if not (data / "models" / "models_info.json").is_file():
        return None
    infos = read_models_info(data)
    targets = _targets(data)
    wanted = [info for info in infos.values() if targets is None or info.name in targets]
    if all(map(_is_ours, wanted)):
        return None
    return [str(i.name) if _is_ours(i) else str(i.mesh_path) for i in wanted]


def _targets(data: Path) -> list[str] | None:
    """Names of the objects that `generate` made a dataset of; None where others made it."""
    manifest = data / "manifest.json"
    if not manifest.is_file():
        return None
    return json.loads(manifest.read_text()).get("settings", {}).get("objects")


def _is_ours(info: BopModelInfo) -> bool:
    """Whether a model is one of the thirteen; LineMOD's own bear the same names."""
    if info.name not in assets.OBJECT_NAMES:
        return False
    model = assets.load_object(str(info.name))
    corner = model.vertices.min(axis=0)
    return (
        model.obj_id == info.obj_id
        and np.allclose(info.minimum, corner, atol=_SAME)
        and np.allclose(info.extents, model.extents, atol=_SAME)
    )
