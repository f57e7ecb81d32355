"""Evaluates an estimator on a BOP dataset."""

from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ..bop.dataset import BopDataset, read_dataset
from ..bop.find_pairs import find_pairs
from ..bop.matching import Matches, difference, match_objects
from ..bop.objects import dataset_objects, has_models, load_objects
from ..bop.pairs import PAIRS_FILE, BopPair, swapped
from ..bop.results import most_confident_per_target, write_bop_results
from ..bop.targets import TARGETS_FILE, is_test, read_targets
from ..methods import find_method
from .config import EvaluateConfig
from .evaluate_pairs import count_left_out, evaluate_pairs, target_pairs
from .metrics import MeasuredObject
from .oracle_rois import NOISE, GroundTruthRois
from .outcomes import Outcome, print_table, summarize


def evaluate_dataset(config: EvaluateConfig, root: Path, tags: Mapping[str, Any]) -> list[dict]:
    """Evaluates on a BOP dataset at ``root``, prints and writes the results."""
    from ...core.results import write_results
    from ..fusion.loading import load

    estimator = load(
        config.method, config.weights,
        preset=config.preset, solver=config.solver, refine=config.refine, device=config.device,
        threads=config.threads,
    )  # fmt: skip
    networks = estimator.networks
    dataset = read_dataset(root, config.split)
    pairs = list(find_pairs(dataset, config.pairs, config.gaps))
    if config.gaps or (config.pairs is None and not (root / PAIRS_FILE).is_file()):
        print(f"{len(pairs)} pairs of views found from the poses of {root / config.split}")
    if config.both_directions:
        pairs += [swapped(pair) for pair in pairs]
    rois = None
    if config.roi != "detector":
        scale = networks.features.config.roi_scale
        rois = GroundTruthRois(scale, *NOISE[config.roi], seed=config.seed)
    matches = match_objects(root, networks.objects)
    targets = _targets(dataset)
    outcomes = evaluate_pairs(
        estimator, dataset, pairs, matches.objects,
        depth=find_method(config.method).needs_depth,
        ground_truth_rois=rois,
        surfaces=_surfaces(config, dataset, matches.objects),
        targets=targets,
        baselines=config.baselines,
    )  # fmt: skip
    if not outcomes:
        raise InputError(
            f"no pair of views of {root / config.split} shows what the weights {config.weights} "
            f"know: {', '.join(f'{n} ({m.obj_id})' for n, m in networks.objects.items())}"
            + "".join(f"; {line}" for line in str(matches).splitlines())
        )
    changed = {n: getattr(config, n) for n in _changed(config) if n in ("solver", "roi")}
    tags = {"method": config.method, **tags, **changed}
    records = summarize(outcomes, tags, config.seed)
    words = {"solver": "solver {}", "roi": "ground-truth ROI: {}"}
    print_table(records, ", ".join(words.get(k, "{}").format(tag) for k, tag in tags.items()))
    _print_left_out(config, pairs, matches, targets, len(outcomes))
    _say_depth_use(outcomes)
    for gap in sorted({o.gap for o in outcomes if o.gap is not None}):
        group = [o for o in outcomes if o.gap == gap]
        records += summarize(group, {**tags, "gap": gap}, config.seed)
    if config.csv is not None:
        found = [(o.estimate, o.uncertainty) for o in outcomes if o.estimate is not None]
        write_bop_results(config.csv, most_confident_per_target(found))
    if config.json is not None:
        write_results(config.json, records, command=_command(config), seed=config.seed)
    return records


def _say_depth_use(outcomes: Sequence[Outcome]) -> None:
    """Prints where depth maps were of no use."""
    from ..fusion.depth_agreement import agrees, enough

    uses = [o.depth_use for o in outcomes if o.depth_use is not None]
    few = sum(not enough(use) for use in uses)
    if few:
        print(
            f"{few} of {len(uses)} depth maps show too little of the object; with hardly a point "
            "the answer is that of one view"
        )
    ratios = [use.distance / use.expected for use in uses if use.distance and not agrees(use)]
    if ratios:
        print(
            f"in {len(ratios)} of {len(uses)} the depth map puts the object where the image does "
            f"not, in the median at {np.median(ratios):.2g} times the distance; if these are many "
            "check depth_scale in scene_camera.json (check-data does)"
        )


def _surfaces(
    config: EvaluateConfig, dataset: BopDataset, objects: Mapping[str, ObjectModel]
) -> Mapping[str, MeasuredObject] | None:
    """Returns the models on which errors are measured, by name; None: those of ``objects``.

    On a dataset given by ``--data`` they are the dataset's, or those of ``--objects`` where it has
    none. On scenes that we rendered only those whose surface is not stored with the weights.

    Raises:
        InputError: if a model is invalid, or a mesh of ``--objects`` is another object.
    """
    names = {
        model.obj_id: name
        for name, model in objects.items()
        if config.data is not None or not model.has_surface
    }
    surfaces: dict[str, MeasuredObject] = {}
    if has_models(dataset.root):
        found = dataset_objects(dataset.root, names, ignore_unknown=True)
        surfaces = {names[obj_id]: measured for obj_id, measured in found.items()}
    given = load_objects(config.objects) if config.data is not None and config.objects else {}
    for name, model in given.items():
        if name not in objects:
            known = ", ".join(objects)
            raise InputError(f"--objects {name} is not what the weights know: {known}")
        corner, extents = model.vertices.min(axis=0), model.extents
        if reason := difference(objects[name], model.diameter, corner, extents):
            raise InputError(f"--objects {name} {reason}, as the weights know it")
        surfaces.setdefault(name, model)
    return surfaces or None


def _print_left_out(
    config: EvaluateConfig,
    pairs: Sequence[BopPair],
    matches: Matches,
    targets: Container[tuple[int, int, int]] | None,
    measured: int,
) -> None:
    """Prints which objects and pairs were not measured, and why."""
    if config.data is None:  # what we render shows fewer objects on purpose
        matches = replace(matches, absent=())
    if text := str(matches):
        print(text)
    if config.data is None:
        return
    reasons = count_left_out(pairs, matches.objects, targets, config.baselines)
    cases = sum(1 for _ in target_pairs(pairs, matches.objects, targets, config.baselines))
    if cases > measured:
        reasons["not annotated in both images"] = cases - measured
    for reason, count in reasons.most_common():
        print(f"left out: {count} times in a pair, {reason}")


def _targets(dataset: BopDataset) -> set[tuple[int, int, int]] | None:
    """Returns the (scene_id, im_id, obj_id) in a test split's list of targets; None without one."""
    if not (is_test(dataset.split) and (dataset.root / TARGETS_FILE).is_file()):
        return None
    return {target[:3] for target in read_targets(dataset)}


def _changed(config: EvaluateConfig) -> list[str]:
    """Returns those of these options that do not have their default value."""
    names = ("preset", "solver", "roi", "baselines")
    return [name for name in names if getattr(config, name) != getattr(EvaluateConfig, name)]


def _command(config: EvaluateConfig) -> str:
    """Returns the command line that repeats the evaluation."""
    options = f"evaluate --method {config.method} --weights {config.weights}"
    for name in _changed(config):
        value = getattr(config, name)
        options += f" --{name} " + ("{:g} {:g}".format(*value) if name == "baselines" else value)
    if config.gaps:
        options += f" --gaps {' '.join(map(str, config.gaps))}"
    return options + " --both-directions" * config.both_directions
