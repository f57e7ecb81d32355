"""How well an estimator does on a BOP dataset of pictures with known poses."""

from __future__ import annotations

import time
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..assets.object_model import ObjectModel
from .bop import BopDataset, BopPair, read_dataset, read_depth, read_rgb
from .bop_objects import dataset_objects, has_models
from .bop_pairs import PAIRS_FILE, turned_round
from .bop_results import BopResult, surest_of_each_target, write_bop_results
from .bop_targets import TARGETS_FILE, is_test, read_targets
from .estimate import PoseEstimate, Roi
from .evaluate_config import EvaluateConfig
from .find_pairs import find_pairs
from .geometry import View
from .metrics import MeasuredObject, add_or_add_s
from .outcomes import Outcome, print_table, summarise
from .told_regions import NOISE, ToldRegions

if TYPE_CHECKING:
    from .networks import PoseNetworks


class _Estimator(Protocol):
    @property
    def object_names(self) -> tuple[str, ...]: ...

    # It is given regions of interest only where ``told`` says so.
    def estimate(
        self, views: Sequence[View], object_name: str, rois: Sequence[Roi] | None = None
    ) -> PoseEstimate: ...


def target_pairs(
    pairs: Sequence[BopPair],
    objects: Mapping[str, ObjectModel],
    targets: Container[tuple[int, int, int]] | None = None,
    baselines: tuple[float, float] = (0.0, 180.0),
) -> Iterator[tuple[BopPair, str]]:
    """Every pair with an object to estimate: its target where it names one, else all it shows.

    Args:
        pairs: of a dataset.
        objects: those that can be estimated.
        targets: (scene_id, im_id, obj_id) of what counts where a pair names no target; None: all.
        baselines: smallest and largest angle in degrees between the views, seen from the object.
    """
    names = {model.obj_id: name for name, model in objects.items()}
    for pair in pairs:
        wanted = pair.obj_ids if pair.target_obj_id is None else (pair.target_obj_id,)
        for obj_id in wanted:
            key = (pair.scene_id, pair.ref_image_id, obj_id)
            counts = pair.target_obj_id is not None or targets is None or key in targets
            if not baselines[0] <= baseline_at(pair, obj_id) <= baselines[1]:
                continue
            if obj_id in names and counts:
                yield pair, names[obj_id]


def baseline_at(pair: BopPair, obj_id: int) -> float:
    """The angle in degrees at one object; that of the pair where it does not say."""
    return float(pair.baselines_deg.get(obj_id, pair.baseline_deg))


def evaluate_pairs(
    estimator: _Estimator,
    dataset: BopDataset,
    pairs: Sequence[BopPair],
    objects: Mapping[str, ObjectModel],
    *,
    views: int = 2,
    depth: bool = False,
    told: ToldRegions | None = None,
    surfaces: Mapping[str, MeasuredObject] | None = None,
    targets: Container[tuple[int, int, int]] | None = None,
    baselines: tuple[float, float] = (0.0, 180.0),
    progress: bool = True,
) -> list[Outcome]:
    """Runs an estimator on pairs of views.

    Args:
        estimator: what to measure; it is told the pictures, cameras and the object's name.
        dataset: where the pictures and the true poses are.
        pairs: see :func:`target_pairs`.
        objects: the models.
        views: 1 leaves the second view out.
        depth: whether the estimator is given depth maps.
        told: for analyses only: regions of interest that the estimator is told. None leaves it to
            find the object.
        surfaces: what errors are measured on, by the objects' names; None: ``objects``.
        targets, baselines: see :func:`target_pairs`.
        progress: whether to show a bar.

    Returns:
        One outcome for each pair and target that both pictures are annotated with.

    Raises:
        ValueError: if ``depth`` is asked for and the dataset has none.
    """
    from tqdm import tqdm

    work = list(target_pairs(pairs, objects, targets, baselines))
    scene_id, scene = -1, {}
    outcomes = []
    bar = tqdm(work, desc="evaluating", unit="pair", disable=not progress)
    for number, (pair, name) in enumerate(bar):
        if pair.scene_id != scene_id:
            scene_id, scene = pair.scene_id, dataset.scene(pair.scene_id)
        model = objects[name]
        reference, second = scene[pair.ref_image_id], scene[pair.second_image_id]
        truth, truth_second = (image.annotation(model.obj_id) for image in (reference, second))
        if truth is None or truth_second is None:
            continue
        if depth and reference.depth_path is None:
            raise ValueError(
                f"{dataset.root} has no depth maps, which the estimator needs: generate it anew "
                "with --depth"
            )
        cameras = [(reference, np.eye(4)), (second, pair.T_second_ref)][:views]
        given = [
            View(read_rgb(image), image.K, T, read_depth(image) if depth else None)
            for image, T in cameras
        ]
        rois: tuple[list[Roi], ...] = ()
        if told is not None:
            poses = (truth.T_cam_obj, truth_second.T_cam_obj)[:views]
            rois = (told.regions(poses, given, model.diameter, number),)
        start = time.perf_counter()
        estimate = estimator.estimate(given, name, *rois)
        seconds = time.perf_counter() - start
        surface = (surfaces or objects).get(name, model)
        error = add_or_add_s(estimate.T_cam_obj, truth.T_cam_obj, surface) / surface.diameter
        score = estimate.rois[0].score if estimate.rois else 1.0
        row = (pair.scene_id, pair.ref_image_id, model.obj_id, score, estimate.T_cam_obj, seconds)
        variance = np.trace(estimate.keypoint_covariance, axis1=1, axis2=2).mean()
        outcomes.append(
            Outcome(
                object_name=name,
                error=float(error),
                keypoint_distance=distance_of_keypoints(estimate.keypoints, truth.T_cam_obj, model),
                seconds=seconds,
                baseline=baseline_at(pair, model.obj_id),
                visibility=truth.visibility,
                score=score,
                gap=pair.gap,
                estimate=BopResult(*row),
                uncertainty=float(np.sqrt(variance)),
            )
        )
    return outcomes


def distance_of_keypoints(keypoints: np.ndarray, T_true: np.ndarray, model: ObjectModel) -> float:
    """Mean distance (m) of predicted 3D keypoints (9, 3) from the nearest equivalent truth."""
    distances = []
    for S in model.symmetries:
        T = T_true @ S
        truth = model.keypoints @ T[:3, :3].T + T[:3, 3]
        distances.append(np.linalg.norm(keypoints - truth, axis=1).mean())
    return float(min(distances))


def evaluate_dataset(config: EvaluateConfig, root: Path, tags: Mapping[str, Any]) -> list[dict]:
    """Evaluates on a BOP dataset at ``root``, prints and writes what came out."""
    import torch

    from . import load
    from .results import write_results

    if config.threads:
        torch.set_num_threads(config.threads)
    estimator = load(config.method, config.weights, preset=config.preset, solver=config.solver)
    networks = estimator.networks
    dataset = read_dataset(root, config.split)
    pairs = list(find_pairs(dataset, config.pairs))
    if config.pairs is None and not (root / PAIRS_FILE).is_file():
        print(f"{len(pairs)} pairs of views found from the poses of {root / config.split}")
    if config.both_ways:
        pairs += [turned_round(pair) for pair in pairs]
    outcomes = evaluate_pairs(
        estimator,
        dataset,
        pairs,
        networks.objects,
        depth=config.method == "rgbd",
        told=_told_regions(config, networks),
        surfaces=_surfaces(config, dataset, networks.objects),
        targets=_targets(dataset),
        baselines=config.baselines,
    )
    if not outcomes:
        raise ValueError(
            f"no pair of views of {root / config.split} shows what the weights {config.weights} "
            f"know: {', '.join(f'{n} ({m.obj_id})' for n, m in networks.objects.items())}"
        )
    tags = {"method": config.method, **tags}
    if config.solver != "soft":
        tags["solver"] = config.solver
    if config.roi != "detector":
        tags["roi"] = config.roi
    records = summarise(outcomes, tags, config.seed)
    print_table(records, _title(tags))
    for gap in sorted({o.gap for o in outcomes if o.gap is not None}):
        group = [o for o in outcomes if o.gap == gap]
        records += summarise(group, {**tags, "gap": gap}, config.seed)
    if config.csv is not None:
        found = [(o.estimate, o.uncertainty) for o in outcomes if o.estimate is not None]
        write_bop_results(config.csv, surest_of_each_target(found))
    if config.json is not None:
        write_results(config.json, records, command=_command(config), seed=config.seed)
    return records


def _told_regions(config: EvaluateConfig, networks: PoseNetworks) -> ToldRegions | None:
    """What ``config.roi`` means."""
    if config.roi == "detector":
        return None
    scale = networks.features.config.roi_scale
    return ToldRegions(scale, *NOISE[config.roi], seed=config.seed)


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
    words = {"solver": "solver {}", "roi": "regions of interest told: {}"}
    return ", ".join(words.get(name, "{}").format(tag) for name, tag in tags.items())


def _command(config: EvaluateConfig) -> str:
    """The command line that repeats a measurement."""
    options = f"evaluate --method {config.method} --weights {config.weights}"
    for name in ("preset", "solver", "roi"):
        if getattr(config, name) != getattr(EvaluateConfig, name):
            options += f" --{name} {getattr(config, name)}"
    if config.baselines != EvaluateConfig.baselines:
        options += " --baselines {:g} {:g}".format(*config.baselines)
    return options + " --both-ways" * config.both_ways
