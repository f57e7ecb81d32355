"""Finds which objects of a dataset are those that an estimator knows.

Numbers alone do not tell: object 5 is LineMOD's can, and YCB-V's mustard bottle.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...assets.object_model import ObjectModel
from .fields import MM
from .models_info import read_models_info
from .objects import SAME_DIAMETER, has_models, info_folder


@dataclass(frozen=True)
class Matches:
    """The objects that a dataset and an estimator share.

    Attributes:
        objects: name -> object, with the dataset's number.
        different: name -> how the dataset's object of that number or name differs.
        absent: names of which the dataset has neither number nor name.
        compared: whether the dataset has models to compare with.
    """

    objects: dict[str, ObjectModel]
    different: dict[str, str]
    absent: tuple[str, ...] = ()
    compared: bool = True

    def __str__(self) -> str:
        """One line for each reason to leave objects out; empty where none is."""
        lines = [f"{name} is left out: {reason}" for name, reason in self.different.items()]
        if self.absent:
            lines.append(f"not in the dataset: {', '.join(self.absent)}")
        if not self.compared:
            lines.append(
                "the dataset has no models to compare with: objects are matched by their numbers "
                f"alone, {', '.join(f'{name} is {m.obj_id}' for name, m in self.objects.items())}"
            )
        return "\n".join(lines)


def match_objects(root: str | Path, objects: Mapping[str, ObjectModel]) -> Matches:
    """Matches objects with those of a dataset: by number, else by name, if their sizes agree.

    Diameter and the corners of the bounding box must agree within a tenth of the diameter: poses
    are of the object's own frame, so a turned or shifted mesh is another object.

    Args:
        root: the dataset's folder.
        objects: name -> object.

    Raises:
        InputError: if ``models_info.json`` is invalid.
    """
    if not has_models(root):
        return Matches(dict(objects), {}, compared=False)
    infos = read_models_info(root, info_folder(root))
    named = {info.name: info for info in infos.values() if info.name is not None}
    shared: dict[str, ObjectModel] = {}
    different: dict[str, str] = {}
    absent: list[str] = []
    taken: dict[int | None, str] = {}
    for name, model in objects.items():
        candidates = [i for i in (named.get(name), infos.get(model.obj_id)) if i is not None]
        reasons = {
            info.obj_id: difference(model, info.diameter, info.minimum, info.extents)
            for info in candidates
        }
        same = next((obj_id for obj_id, reason in reasons.items() if not reason), None)
        if same in taken:
            different[name] = f"object {same} of the dataset is {taken[same]}"
        elif same is not None:
            shared[name] = model if same == model.obj_id else replace(model, obj_id=same)
            taken[same] = name
        elif reasons:
            listed = (f"object {i} of the dataset {reason}" for i, reason in reasons.items())
            different[name] = "; ".join(listed)
        else:
            absent.append(f"{name} ({model.obj_id})")
    return Matches(shared, different, tuple(absent))


def difference(
    model: ObjectModel, diameter: float, minimum: np.ndarray, extents: np.ndarray
) -> str:
    """Returns how an object differs from one of this diameter and bounding box, or nothing."""
    tolerance = SAME_DIAMETER * model.diameter
    low, sides = model.vertices.min(axis=0), model.extents
    if abs(diameter - model.diameter) > tolerance or np.abs(extents - sides).max() > tolerance:
        return f"is {_size(diameter, extents)}, not {_size(model.diameter, sides)}"
    if np.abs(minimum - low).max() > tolerance:
        return f"has its origin elsewhere, {MM * float(np.linalg.norm(minimum - low)):.0f} mm off"
    return ""


def _size(diameter: float, extents: np.ndarray) -> str:
    sides = " x ".join(f"{MM * side:.0f}" for side in extents)
    return f"{MM * diameter:.0f} mm across ({sides})"
