"""Names the mistake that explains why a file's poses are wrong: units, conventions, numbers."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ...core.geometry import invert, transform
from ..bop.dataset import BopAnnotation
from ..bop.fields import MM
from ..bop.objects import EvaluationObject
from ..bop.pose_mistakes import pose_corrections
from ..bop.results import BopResult
from .metrics import CORRECT

EXPLAINS = 0.05
GAIN = 3.0
"""A mistake explains the poses if corrected at least this share is right, and so many times as many
as written."""

MAX_SAMPLE = 200
"""Estimates to look at, the most confident ones of evenly spread targets."""

_POINTS = 50
_MAX_SYMMETRIES = 144
_MIN_RIGHT = 3
"""Fewer right estimates may be so by chance."""

Truths = Mapping[tuple[int, int], Sequence[BopAnnotation]]


class Case(NamedTuple):
    """An estimate, its object, and the object's true poses (N, 4, 4) in the image, N > 0."""

    estimate: BopResult
    model: EvaluationObject
    truths: np.ndarray


def explain_results(
    results: Sequence[BopResult], truths: Truths, objects: Mapping[int, EvaluationObject]
) -> str | None:
    """Returns the mistake that explains a file of wrong poses, and what to do; None without one.

    Args:
        results: the estimates.
        truths: (scene id, image id) -> annotations.
        objects: obj_id -> object.
    """
    confident = {e.target: e for e in sorted(results, key=lambda e: e.score)}
    of_targets = [confident[target] for target in sorted(confident)]
    sample = [of_targets[i] for i in _spread(len(of_targets))]
    cases = [case for e in sample if (case := _case(e, e.image_id, truths, objects)) is not None]
    if not sample:
        return None
    count, mistakes = len(sample), Counter[tuple[str, str]]()
    written = sum(_near(c, c.estimate.T_cam_obj) for c in cases) / count
    for case in cases:
        for correction in pose_corrections(case.estimate.T_cam_obj, np.eye(3)):
            key = _of_results(correction.cause), _of_results(correction.remedy)
            mistakes[key] += _near(case, correction.T_cam_obj)
    for shift in (-1, 1):
        shifted = (_case(e, e.image_id + shift, truths, objects) for e in sample)
        near = sum(_near(c, c.estimate.T_cam_obj) for c in shifted if c is not None)
        mistakes[f"im_id is off by {shift:+d}", f"add {shift} to im_id"] += near
    for key, number in (*_frames(cases), *_numbers(sample, truths, objects)):
        mistakes[key] += number
    (cause, remedy), best = mistakes.most_common(1)[0]  # the first of equal ones: the simplest
    if best < max(EXPLAINS * count, GAIN * written * count, _MIN_RIGHT):
        return None
    return (
        f"of {count} estimates, {100 * written:.0f} % are right as written, and "
        f"{100 * best / count:.0f} % if {cause}. {remedy[0].upper()}{remedy[1:]}, and "
        "score the file again"
    )


def _spread(count: int) -> list[int]:
    return np.linspace(0, count - 1, min(count, MAX_SAMPLE)).astype(int).tolist()


def _case(
    estimate: BopResult, image_id: int, truths: Truths, objects: Mapping[int, EvaluationObject]
) -> Case | None:
    """Returns an estimate with the truth of an image; None where that does not show the object."""
    shown = [
        a.T_cam_obj
        for a in truths.get((estimate.scene_id, image_id), ())
        if a.obj_id == estimate.obj_id
    ]
    if not shown or estimate.obj_id not in objects:
        return None
    return Case(estimate, objects[estimate.obj_id], np.stack(shown))


def _near(case: Case, T_cam_obj: np.ndarray) -> bool:
    """Whether a pose is right: near one of the true ones, up to the object's symmetries."""
    model = case.model
    near = CORRECT * model.diameter
    points = model.points[:: max(1, len(model.points) // _POINTS)]
    center = points.mean(axis=0)
    step = max(1, len(model.symmetries) // _MAX_SYMMETRIES)
    for truth in case.truths:
        # The mean of the distances is at least the distance of the means.
        if np.linalg.norm(transform(T_cam_obj, center) - transform(truth, center)) > 2 * near:
            continue
        equivalents = truth @ model.symmetries[::step]
        placed = points @ equivalents[:, :3, :3].mT + equivalents[:, None, :3, 3]
        distances = np.linalg.norm(placed - transform(T_cam_obj, points), axis=-1)
        if distances.mean(axis=1).min() < near:
            return True
    return False


def _of_results(text: str) -> str:
    """Names the fields of a result file instead of those of scene_gt.json."""
    return text.replace("cam_t_m2c", "t").replace("cam_R_m2c", "R")


Explained = tuple[tuple[str, str], int]
"""Cause and remedy, and the number of estimates that they explain."""


def _frames(cases: Sequence[Case]) -> Iterator[Explained]:
    """Yields that the poses are of other model frames, with the motion of the first object."""
    by_object: dict[int, list[Case]] = defaultdict(list)
    for case in cases:
        by_object[case.estimate.obj_id].append(case)
    total, described = 0, ""
    for obj_id, of_object in by_object.items():
        if len(of_object) <= _MIN_RIGHT:
            continue
        best, motion = 0, np.eye(4)
        for other in of_object[:5]:
            T = invert(other.estimate.T_cam_obj) @ other.truths[0]
            moved = (_near(c, c.estimate.T_cam_obj @ T) for c in of_object if c is not other)
            if (number := sum(moved)) > best:
                best, motion = number, T
        if best >= _MIN_RIGHT:
            total += best
            degrees = np.degrees(Rotation.from_matrix(motion[:3, :3]).magnitude())
            shift = MM * np.linalg.norm(motion[:3, 3])
            described = described or f"object {obj_id} is {shift:.0f} mm and {degrees:.0f} degrees"
    if described:
        yield (
            (
                f"they are of models in another frame ({described} off)",
                "estimate with the dataset's own models, or move the poses into their frames",
            ),
            total,
        )


def _numbers(
    sample: Sequence[BopResult], truths: Truths, objects: Mapping[int, EvaluationObject]
) -> Iterator[Explained]:
    """Yields that the objects are numbered otherwise, with the numbers that fit."""
    fits: dict[int, Counter[int]] = defaultdict(Counter)
    for estimate in sample:
        shown = {a.obj_id for a in truths.get(estimate.target[:2], ())} - {estimate.obj_id}
        for obj_id in shown & objects.keys():
            renumbered = replace(estimate, obj_id=obj_id)
            case = _case(renumbered, estimate.image_id, truths, objects)
            fits[estimate.obj_id][obj_id] += case is not None and _near(case, estimate.T_cam_obj)
    best = {i: fit.most_common(1)[0] for i, fit in fits.items() if fit}
    found = {i: (other, n) for i, (other, n) in best.items() if n >= _MIN_RIGHT}
    if found:
        listed = ", ".join(f"{i} is {other}" for i, (other, _) in sorted(found.items()))
        yield (
            (f"obj_id has other numbers ({listed})", "write the dataset's numbers"),
            sum(n for _, n in found.values()),
        )
