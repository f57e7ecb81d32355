"""Checks ``models_eval``, on which errors are measured, against ``models``."""

from collections.abc import Mapping

import numpy as np
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from .cameras import rigid_or_nan
from .findings import Findings
from .meshes import CheckedModel
from .models import DENSE_POINTS, SAME_SIZE, SIZES
from .units import format_length, unit_of_factor

OTHER_FRAME = 0.03
"""Mean distance of two surfaces, in diameters, above which one was moved or turned."""

OTHER_SYMMETRY = 0.1
"""Difference of two transforms' numbers, translations in diameters, above which they differ."""

_POINTS = 600


def check_folders(
    models: Mapping[int, CheckedModel],
    evaluation: Mapping[int, CheckedModel],
    findings: Findings,
) -> None:
    """Compares the objects of ``models`` and ``models_eval``, each obj_id -> object."""
    for obj_id in sorted(models.keys() ^ evaluation.keys()):
        there, lacking = (
            (models, evaluation) if obj_id in models else (evaluation, models)
        )  # fmt: skip
        lacks = next(iter(lacking.values())).info_path if lacking else there[obj_id].info_path
        findings.warning(
            lacks, "keys", "an object is in only one of models and models_eval",
            detail=f"object {obj_id} is in {there[obj_id].info_path.parent.name} only",
            cause="the folders are of different versions of the dataset",
            remedy="add it: training reads models, evaluation models_eval",
        )  # fmt: skip
    for obj_id in sorted(models.keys() & evaluation.keys()):
        first, second = models[obj_id], evaluation[obj_id]
        if first.mesh is not None and second.mesh is not None:
            _compare_meshes(first, first.mesh, second, second.mesh, findings)
        if first.info_path != second.info_path:
            _compare_symmetries(first, second, findings)


def _compare_meshes(
    first: CheckedModel,
    mesh: trimesh.Trimesh,
    second: CheckedModel,
    other: trimesh.Trimesh,
    findings: Findings,
) -> None:
    """Compares size and place of two meshes of one object."""
    low, high = SIZES
    if not all(low <= model.measured <= high for model in (first, second)):
        return  # it is a finding already
    path, name = second.info.mesh_path, f"object {second.obj_id}"
    ratio = second.measured / first.measured
    if abs(ratio - 1) > SAME_SIZE:
        unit, inverse = unit_of_factor(ratio), unit_of_factor(1 / ratio)
        cause, remedy = "it is of another version of the object", "export both from one mesh"
        if unit is not None:
            cause, remedy = f"it is in {unit[0]}", f"multiply the vertices by {unit[1]:g}"
        elif inverse is not None:
            cause = f"the mesh in models is in {inverse[0]}"
            remedy = f"multiply the vertices in models by {inverse[1]:g}"
        findings.error(
            path, "vertices", "the mesh has another size than in models",
            detail=f"{name}: {format_length(second.measured)}, in models "
            f"{format_length(first.measured)}",
            cause=cause, remedy=remedy,
        )  # fmt: skip
        return
    step = max(1, len(other.vertices) // _POINTS)
    surface, _ = trimesh.sample.sample_surface(mesh, DENSE_POINTS, seed=0)
    distance = float(KDTree(surface).query(other.vertices[::step])[0].mean())
    if distance > OTHER_FRAME * first.measured:
        shift = np.linalg.norm((second.bounds - first.bounds).mean(axis=0))
        findings.error(
            path, "vertices", "the mesh has another frame than in models",
            detail=f"{name}: surfaces are {format_length(distance)} apart on average, centers "
            f"{format_length(float(shift))}",
            cause="it was moved or turned, while poses are of the frame of models",
            remedy="export both from one mesh, without centering or aligning it",
        )  # fmt: skip


def _compare_symmetries(first: CheckedModel, second: CheckedModel, findings: Findings) -> None:
    """Compares what the two files list: training uses one, evaluation the other."""
    size = first.info.diameter
    listed = []
    for info in (first.info, second.info):
        if not (rigid_or_nan(info.discrete) & ~np.isnan(info.discrete).any(axis=(1, 2))).all():
            return  # it is a finding already
        numbers = info.symmetries[:, :3].copy()
        numbers[..., 3] /= size
        listed.append(numbers.reshape(-1, 12))
    distance = cdist(*listed)
    farthest = max(distance.min(axis=1).max(), distance.min(axis=0).max())
    if np.isfinite(size) and farthest > OTHER_SYMMETRY:
        findings.warning(
            second.info_path, "symmetries_discrete, symmetries_continuous",
            "the symmetries differ from those in models",
            detail=f"object {second.obj_id}: {len(listed[1])} transforms, in models "
            f"{len(listed[0])}",
            cause="symmetries were added to one of the two models_info.json",
            remedy="copy one file over the other: training reads models, evaluation models_eval",
        )  # fmt: skip
