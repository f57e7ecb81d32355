"""Evaluates an estimator on a BOP dataset."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ..bop.dataset import BopDataset, read_dataset
from ..bop.find_pairs import find_pairs
from ..bop.objects import dataset_objects, has_models
from ..bop.pairs import PAIRS_FILE, turned_round
from ..bop.results import surest_of_each_target, write_bop_results
from ..bop.targets import TARGETS_FILE, is_test, read_targets
from ..methods import find_method
from .config import EvaluateConfig
from .evaluate_pairs import evaluate_pairs
from .metrics import MeasuredObject
from .oracle_rois import NOISE, GroundTruthRois
from .outcomes import print_table, summarize

if TYPE_CHECKING:
    from ..networks.container import PoseNetworks


def evaluate_dataset(config: EvaluateConfig, root: Path, tags: Mapping[str, Any]) -> list[dict]:
    """Evaluates on a BOP dataset at ``root``, prints and writes what came out."""
    from ...core.results import write_results
    from ..fusion.loading import load

    estimator = load(
        config.method, config.weights,
        preset=config.preset, solver=config.solver, device=config.device, threads=config.threads,
    )  # fmt: skip
    networks = estimator.networks
    dataset = read_dataset(root, config.split)
    pairs = list(find_pairs(dataset, config.pairs))
    if config.pairs is None and not (root / PAIRS_FILE).is_file():
        print(f"{len(pairs)} pairs of views found from the poses of {root / config.split}")
    if config.both_directions:
        pairs += [turned_round(pair) for pair in pairs]
    outcomes = evaluate_pairs(
        estimator,
        dataset,
        pairs,
        networks.objects,
        depth=find_method(config.method).needs_depth,
        ground_truth_rois=_ground_truth_rois(config, networks),
        surfaces=_surfaces(config, dataset, networks.objects),
        targets=_targets(dataset),
        baselines=config.baselines,
    )
    if not outcomes:
        raise InputError(
            f"no pair of views of {root / config.split} shows what the weights {config.weights} "
            f"know: {', '.join(f'{n} ({m.obj_id})' for n, m in networks.objects.items())}"
        )
    tags = {"method": config.method, **tags}
    if config.solver != "soft":
        tags["solver"] = config.solver
    if config.roi != "detector":
        tags["roi"] = config.roi
    records = summarize(outcomes, tags, config.seed)
    print_table(records, _title(tags))
    for gap in sorted({o.gap for o in outcomes if o.gap is not None}):
        group = [o for o in outcomes if o.gap == gap]
        records += summarize(group, {**tags, "gap": gap}, config.seed)
    if config.csv is not None:
        found = [(o.estimate, o.uncertainty) for o in outcomes if o.estimate is not None]
        write_bop_results(config.csv, surest_of_each_target(found))
    if config.json is not None:
        write_results(config.json, records, command=_command(config), seed=config.seed)
    return records


def _ground_truth_rois(config: EvaluateConfig, networks: PoseNetworks) -> GroundTruthRois | None:
    """What ``config.roi`` means."""
    if config.roi == "detector":
        return None
    scale = networks.features.config.roi_scale
    return GroundTruthRois(scale, *NOISE[config.roi], seed=config.seed)


def _surfaces(
    config: EvaluateConfig, dataset: BopDataset, objects: Mapping[str, ObjectModel]
) -> Mapping[str, MeasuredObject] | None:
    """The dataset's own models of the objects, where it is not rendered by us and has some."""
    if config.data is None or not has_models(dataset.root):
        return None
    names = {model.obj_id: name for name, model in objects.items()}
    found = dataset_objects(dataset.root, names, ignore_unknown=True)
    return {names[obj_id]: measured for obj_id, measured in found.items()}


def _targets(dataset: BopDataset) -> set[tuple[int, int, int]] | None:
    """(scene_id, im_id, obj_id) that a test split lists as targets; None where it has no list."""
    if not (is_test(dataset.split) and (dataset.root / TARGETS_FILE).is_file()):
        return None
    return {target[:3] for target in read_targets(dataset)}


def _title(tags: Mapping[str, Any]) -> str:
    """What a table shows, in words."""
    words = {"solver": "solver {}", "roi": "ground-truth ROI: {}"}
    return ", ".join(words.get(name, "{}").format(tag) for name, tag in tags.items())


def _command(config: EvaluateConfig) -> str:
    """The command line that repeats a measurement."""
    options = f"evaluate --method {config.method} --weights {config.weights}"
    for name in ("preset", "solver", "roi"):
        if getattr(config, name) != getattr(EvaluateConfig, name):
            options += f" --{name} {getattr(config, name)}"
    if config.baselines != EvaluateConfig.baselines:
        options += " --baselines {:g} {:g}".format(*config.baselines)
    return options + " --both-directions" * config.both_directions
