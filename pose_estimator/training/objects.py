"""The objects of a training: those that are requested, else those of the dataset."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ... import assets
from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ..bop.manifest import read_manifest
from ..bop.matching import match_objects
from ..bop.models_info import BopModelInfo, read_models_info
from ..bop.objects import load_objects

_TOLERANCE = 1e-4
"""Maximum difference in meters of the bounding boxes of one model."""


def training_objects(
    data: Path, objects: Sequence[str], unit: str = "auto"
) -> dict[str, ObjectModel]:
    """Returns the objects of a training, by name.

    Args:
        data: the dataset.
        objects: the requested names and meshes. If there are none: the dataset's own models, or
            the built-in objects where :func:`dataset_models` returns None.
        unit: of requested mesh files.

    Raises:
        InputError: if a model cannot be read, or a requested object is not the dataset's of that
            number or name.
        FileNotFoundError: if a mesh is missing.
    """
    if objects:
        return _matched(data, load_objects(list(objects), unit))
    specs = dataset_models(data)
    if specs is None:
        return assets.load_objects(None)
    models = load_objects(specs)
    print(f"objects of {data / 'models'}: {', '.join(models)}")
    return models


def _matched(data: Path, objects: Mapping[str, ObjectModel]) -> dict[str, ObjectModel]:
    """Returns requested objects with the dataset's numbers."""
    matches = match_objects(data, objects)
    if matches.different:
        name, reason = next(iter(matches.different.items()))
        raise InputError(
            f"{name} is not in {data}: {reason}; give --objects the dataset's own mesh, such as "
            f"{name}={data / 'models' / 'obj_000001.ply'}"
        )
    return {name: matches.objects.get(name, model) for name, model in objects.items()}


def dataset_models(data: Path) -> list[str] | None:
    """Returns the models of a dataset without distractors, for ``load_objects``.

    None if all of them are built-in objects, or the dataset has no models.
    """
    if not (data / "models" / "models_info.json").is_file():
        return None
    infos = read_models_info(data)
    targets = _generated_objects(data)
    wanted = [info for info in infos.values() if targets is None or info.name in targets]
    if all(map(_is_built_in, wanted)):
        return None
    return [str(i.name) if _is_built_in(i) else str(i.mesh_path) for i in wanted]


def _generated_objects(data: Path) -> list[str] | None:
    """Names of the objects that `generate` made a dataset for; None if it was not generated."""
    manifest = read_manifest(data)
    return None if manifest is None else manifest.get("settings", {}).get("objects")


def _is_built_in(info: BopModelInfo) -> bool:
    """Whether a model is a built-in object, not one of LineMOD's with the same name."""
    if info.name not in assets.OBJECT_NAMES:
        return False
    model = assets.load_object(str(info.name))
    corner = model.vertices.min(axis=0)
    return (
        model.obj_id == info.obj_id
        and np.allclose(info.minimum, corner, atol=_TOLERANCE)
        and np.allclose(info.extents, model.extents, atol=_TOLERANCE)
    )
