"""How well an estimator does on a BOP dataset of pictures with known poses."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from ..assets.object_model import ObjectModel
from .bop import BopDataset, BopPair, read_dataset, read_pairs, read_rgb
from .estimate import PoseEstimate
from .geometry import View
from .metrics import add_or_add_s, bootstrap_interval


class _Estimator(Protocol):
    @property
    def object_names(self) -> tuple[str, ...]: ...

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate: ...


@dataclass(frozen=True)
class EvaluateConfig:
    """Measures an estimator: ADD(-S) below a tenth of the diameter, per object and in the mean.

    Either on fresh scenes of ours (--scene, rendered first), or on a BOP dataset (--data). The
    estimator gets full frames, the camera matrix, the relative camera pose and the object's name.
    """

    method: str = "mid"
    """`single` or `mid`."""
    weights: str = "linemod"
    """Name of shipped weights, or a .safetensors file."""
    scene: Literal["linemod", "occlusion"] = "linemod"
    """Kind of our scenes."""
    scenes: int = 520
    """How many scenes; each of the 13 objects is the target equally often."""
    seed: int = 1000
    """Of the scenes. Training data has other seeds."""
    data: Path | None = None
    """A BOP dataset instead of our scenes."""
    split: str = "test"
    """Folder of its scenes."""
    pairs: Path | None = None
    """File with pairs of views; none = two_view_pairs.json of the dataset."""
    keep: Path | None = None
    """Keep the rendered scenes in this folder; if they are there already, use them."""
    threads: int = 0
    """Threads of the networks; 0 = as many as there are cores."""
    json: Path | None = None
    """Write the figures as a results file."""


@dataclass(frozen=True)
class Outcome:
    """One pair of views, estimated.

    Attributes:
        object_name: the target.
        error: ADD, or ADD-S for symmetric objects, in diameters.
        keypoint_distance: mean distance of the 3D keypoints from the truth, m.
        seconds: that the estimate took.
        baseline: angle between the views as seen from the object, degrees.
        visibility: of the target in the reference view, 0 to 1.
        score: the detector's, in the reference view.
    """

    object_name: str
    error: float
    keypoint_distance: float
    seconds: float
    baseline: float
    visibility: float
    score: float


def target_pairs(
    pairs: Sequence[BopPair], objects: Mapping[str, ObjectModel]
) -> Iterator[tuple[BopPair, str]]:
    """Every pair with an object to estimate: its target where it names one, else all it shows."""
    names = {model.obj_id: name for name, model in objects.items()}
    for pair in pairs:
        wanted = pair.obj_ids if pair.target_obj_id is None else (pair.target_obj_id,)
        for obj_id in wanted:
            if obj_id in names:
                yield pair, names[obj_id]


def evaluate_pairs(
    estimator: _Estimator,
    dataset: BopDataset,
    pairs: Sequence[BopPair],
    objects: Mapping[str, ObjectModel],
    *,
    views: int = 2,
    progress: bool = True,
) -> list[Outcome]:
    """Runs an estimator on pairs of views.

    Args:
        estimator: what to measure; it is told the pictures, cameras and the object's name.
        dataset: where the pictures and the true poses are.
        pairs: see :func:`target_pairs`.
        objects: the models.
        views: 1 leaves the second view out.
        progress: whether to show a bar.

    Returns:
        One outcome for each pair and target that both pictures are annotated with.
    """
    from tqdm import tqdm

    work = list(target_pairs(pairs, objects))
    scene_id, scene = -1, {}
    outcomes = []
    for pair, name in tqdm(work, desc="evaluating", unit="pair", disable=not progress):
        if pair.scene_id != scene_id:
            scene_id, scene = pair.scene_id, dataset.scene(pair.scene_id)
        model = objects[name]
        reference, second = scene[pair.ref_image_id], scene[pair.second_image_id]
        truth = reference.annotation(model.obj_id)
        if truth is None or second.annotation(model.obj_id) is None:
            continue
        given = [View(read_rgb(reference), reference.K, np.eye(4))]
        if views > 1:
            given.append(View(read_rgb(second), second.K, pair.T_second_ref))
        start = time.perf_counter()
        estimate = estimator.estimate(given, name)
        seconds = time.perf_counter() - start
        error = add_or_add_s(estimate.T_cam_obj, truth.T_cam_obj, model) / model.diameter
        outcomes.append(
            Outcome(
                object_name=name,
                error=float(error),
                keypoint_distance=distance_of_keypoints(estimate.keypoints, truth.T_cam_obj, model),
                seconds=seconds,
                baseline=float(pair.baselines_deg.get(model.obj_id, pair.baseline_deg)),
                visibility=truth.visibility,
                score=estimate.rois[0].score if estimate.rois else 1.0,
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


def summarise(outcomes: Sequence[Outcome], tags: Mapping[str, Any], seed: int = 0) -> list[dict]:
    """Records of the results file: each figure for each object, and the mean over the objects."""
    if not outcomes:
        raise ValueError("there is no pair of views with a target to evaluate")
    rng = np.random.default_rng(seed)
    names = list(dict.fromkeys(outcome.object_name for outcome in outcomes))
    figures = {
        "add_s_recall": ("", lambda group: [float(o.error < 0.1) for o in group]),
        "add_over_diameter": ("", lambda group: [min(o.error, 1.0) for o in group]),
        "keypoint_distance": ("m", lambda group: [o.keypoint_distance for o in group]),
    }
    records: list[dict] = []
    for metric, (unit, values_of) in figures.items():
        by_object = {
            name: np.array(values_of([o for o in outcomes if o.object_name == name]))
            for name in names
        }
        for name, values in by_object.items():
            low, high = bootstrap_interval(values, rng)
            records.append(
                {"metric": metric, "value": float(values.mean()), "unit": unit, "object": name,
                 "low": low, "high": high, "n": len(values), **tags}
            )  # fmt: skip
        mean = float(np.mean([values.mean() for values in by_object.values()]))
        low, high = _interval_of_mean(list(by_object.values()), rng)
        records.append(
            {"metric": metric, "value": mean, "unit": unit, "object": "mean",
             "low": low, "high": high, "n": len(outcomes), **tags}
        )  # fmt: skip
    seconds = float(np.median([o.seconds for o in outcomes]))
    records.append({"metric": "seconds_per_pair", "value": seconds, "unit": "s", **tags})
    return records


def _interval_of_mean(
    groups: Sequence[np.ndarray], rng: np.random.Generator, resamples: int = 2000
) -> tuple[float, float]:
    """95 percent bootstrap interval of the mean over objects, resampled within each object."""
    means = [
        values[rng.integers(len(values), size=(resamples, len(values)))].mean(1)
        for values in groups
    ]
    low, high = np.quantile(np.mean(means, axis=0), [0.025, 0.975])
    return float(low), float(high)


def print_table(records: Sequence[Mapping[str, Any]], title: str) -> None:
    """Prints the figures of :func:`summarise` for people."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title)
    for column in ("object", "ADD(-S) < 0.1 d", "95 %", "ADD / d", "keypoints", "pairs"):
        table.add_column(column, justify="left" if column == "object" else "right")
    cells: dict[str, dict[str, Mapping[str, Any]]] = {}
    for record in records:
        if "object" in record:
            cells.setdefault(str(record["object"]), {})[str(record["metric"])] = record
    for name, row in cells.items():
        recall = row["add_s_recall"]
        table.add_row(
            name,
            f"{100 * recall['value']:.1f} %",
            f"{100 * recall['low']:.0f} to {100 * recall['high']:.0f}",
            f"{row['add_over_diameter']['value']:.3f}",
            f"{1000 * row['keypoint_distance']['value']:.1f} mm",
            str(recall["n"]),
            style="bold" if name == "mean" else None,
        )
    Console().print(table)
    for record in records:
        if record["metric"] == "seconds_per_pair":
            print(f"{1000 * record['value']:.0f} ms a pair (median)")


def evaluate_dataset(config: EvaluateConfig, root: Path, tags: Mapping[str, Any]) -> list[dict]:
    """Evaluates on a BOP dataset at ``root``, prints and writes what came out."""
    import torch

    from . import load
    from .results import write_results

    if config.threads:
        torch.set_num_threads(config.threads)
    estimator = load(config.method, config.weights)
    objects = estimator.networks.objects
    dataset = read_dataset(root, config.split)
    outcomes = evaluate_pairs(estimator, dataset, read_pairs(config.pairs or root), objects)
    records = summarise(outcomes, {"method": config.method, **tags}, config.seed)
    print_table(records, f"{config.method}, {', '.join(str(t) for t in tags.values())}")
    if config.json is not None:
        command = f"evaluate --method {config.method} --weights {config.weights}"
        write_results(config.json, records, command=command, seed=config.seed)
    return records
