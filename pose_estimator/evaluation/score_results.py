"""Scores a BOP result file of any method."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...core.results import write_results
from ..bop.dataset import BopAnnotation, read_dataset
from ..bop.objects import EvaluationObject, dataset_objects
from ..bop.results import BopResult, read_bop_results
from ..bop.targets import BopTarget, read_targets
from .config import EvaluateConfig
from .explain_results import explain_results
from .metrics import CORRECT, add_or_add_s
from .outcomes import Outcome, print_table, summarize


def score_file(config: EvaluateConfig, root: Path, tags: Mapping[str, Any]) -> list[dict]:
    """Scores ``config.score`` on the dataset at ``root``, prints and writes the results.

    Raises:
        InputError: if the file or the dataset is not usable; the message names file and line.
    """
    assert config.score is not None
    dataset = read_dataset(root, config.split)
    truths = {(image.scene_id, image.image_id): image.annotations for image in dataset}
    images: dict[int, set[int]] = {}
    for scene_id, image_id in truths:
        images.setdefault(scene_id, set()).add(image_id)
    objects = dataset_objects(root)
    results = read_bop_results(config.score, images, objects)
    targets = read_targets(dataset)
    outcomes = score_results(results, targets, truths, objects)
    # BOP names files METHOD_DATASET-SPLIT.csv.
    tags = {"method": config.score.stem.split("_")[0], **tags}
    records = summarize(outcomes, tags, config.seed)
    print_table(records, ", ".join(map(str, tags.values())), counted="targets")
    asked = {target[:3] for target in targets}
    missing = sum(np.isinf(outcome.error) for outcome in outcomes)
    extra = sum(result.target not in asked for result in results)
    print(f"{missing} targets have no estimate and count as wrong")
    if extra:
        print(f"{extra} estimates are of no target and do not count")
    if (mistake := explain_results(results, truths, objects)) is not None:
        print(f"warning: {mistake}")
    if config.json is not None:
        command = f"evaluate --score {config.score} --data {config.data} --split {config.split}"
        write_results(config.json, records, command=command, seed=config.seed)
    return records


def score_results(
    results: Iterable[BopResult],
    targets: Sequence[BopTarget],
    truths: Mapping[tuple[int, int], Sequence[BopAnnotation]],
    objects: Mapping[int, EvaluationObject],
) -> list[Outcome]:
    """Compares estimates with the ground truth.

    For each target the estimates of highest score count, one for each instance, and the most
    visible instances. They are matched greedily as in bop_toolkit's ``pose_matching``: by
    decreasing score each takes the nearest free instance, first only those below a tenth of the
    diameter.

    Args:
        results: of any method.
        targets: with their numbers of instances.
        truths: (scene id, image id) -> annotations.
        objects: obj_id -> object.

    Returns:
        One outcome for each instance; its error is infinite where it has no estimate.

    Raises:
        InputError: if the dataset lacks a target's image, object or true pose.
    """
    of_target: dict[tuple[int, int, int], list[BopResult]] = {}
    for result in results:
        of_target.setdefault(result.target, []).append(result)
    outcomes = []
    for target in targets:
        name = f"target scene {target.scene_id}, image {target.image_id}, object {target.obj_id}"
        if target.obj_id not in objects:
            raise InputError(f"{name}: the dataset has no model of the object")
        annotations = truths.get(target[:2], ())
        instances = [a for a in annotations if a.obj_id == target.obj_id]
        if len(instances) < target.instances:
            raise InputError(
                f"{name}: scene_gt.json has {len(instances)} of {target.instances} poses; a file "
                "can be scored only where the truth is public"
            )
        instances.sort(key=lambda a: -a.visibility)
        estimates = sorted(of_target.get(target[:3], []), key=lambda e: -e.score)
        model, count = objects[target.obj_id], target.instances
        for truth, estimate, error in _matched(estimates[:count], instances[:count], model):
            score = 0.0 if estimate is None else estimate.score
            known = model.name, error, None, None, 0.0, truth.visibility, score
            outcomes.append(Outcome(*known, estimate=estimate, scene_id=target.scene_id))
    return outcomes


def _matched(
    estimates: Sequence[BopResult], instances: Sequence[BopAnnotation], model: EvaluationObject
) -> Iterator[tuple[BopAnnotation, BopResult | None, float]]:
    """Yields each instance with its estimate, if any, and the error in diameters."""
    errors = np.full((len(estimates), len(instances)), np.inf)
    for e, estimate in enumerate(estimates):
        for i, truth in enumerate(instances):
            errors[e, i] = add_or_add_s(estimate.T_cam_obj, truth.T_cam_obj, model) / model.diameter
    taken: dict[int, int] = {}
    for limit in (CORRECT, np.inf):
        for e in range(len(estimates)):
            free = [i for i in range(len(instances)) if i not in taken]
            if e in taken.values() or not free:
                continue
            nearest = min(free, key=lambda i: errors[e, i])
            if errors[e, nearest] < limit:
                taken[nearest] = e
    for i, truth in enumerate(instances):
        if i in taken:
            yield truth, estimates[taken[i]], float(errors[taken[i], i])
        else:
            yield truth, None, np.inf
