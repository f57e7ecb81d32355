"""Readers of what commands keep: results, logs, manifests, checksums, settings."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from helpers.small_dataset import write_small_dataset
from helpers.solid_scenes import SOLIDS, solid
from two_view_pose.agents.training.hyperparameters import (
    SHIPPED,
    algorithm_kwargs,
    load_hyperparameters,
)
from two_view_pose.core.results import read_results, write_results
from two_view_pose.envs.datagen.checksums import find_problems, write_dataset_sums, write_sums
from two_view_pose.envs.datagen.dataset_folder import check_or_write_manifest
from two_view_pose.pose_estimator.study.log import OutcomeLog, PairOutcome
from two_view_pose.pose_estimator.study.measure import StudySet
from two_view_pose.pose_estimator.training.objects import dataset_models
from two_view_pose.pose_estimator.training.record import TrainingLog, describe_data
from two_view_pose.pose_estimator.training_data.crop_packing import pack_dataset

from .judge import Reader, require

_RESULTS = "results.json"
_KEY = {"networks": "0123", "gaps": [1, 5], "seed": 0}
_SETTINGS = {"scenes": 2, "objects": ["duck"], "seed": 0, "pair_angles": [5.0, 60.0]}


def _write_results(folder: Path) -> None:
    tags = {"method": "mid-pnp", "object": "mean", "n": 20, "scene": "linemod"}
    records = [
        {"metric": "add_s_recall", "value": 0.9, "unit": "", "low": 0.8, "high": 0.95, **tags},
        {"metric": "keypoint_distance", "value": 0.004, "unit": "m", **tags},
    ]
    write_results(folder / _RESULTS, records, command="evaluate --method mid-pnp", seed=0)


def _results(folder: Path) -> None:
    document = read_results(folder / _RESULTS)
    require(isinstance(document["command"], str), f"command {document['command']!r}")
    require(isinstance(document["versions"], dict), f"versions {document['versions']!r}")
    require(isinstance(document["seed"], int | None), f"seed {document['seed']!r}")
    for record in document["records"]:
        require(math.isfinite(record["value"]), f"{record}")


def _write_outcomes(folder: Path) -> None:
    log = OutcomeLog(folder / "pnp.jsonl", _KEY, "abc")
    log.add(
        PairOutcome(
            3, i, 5, "cat", 5, 0.02, (0.001, 0.003), 0.8, 0.9, 4.5, {"soft": 0.02, "pnp": 0.1}
        )
        for i in range(3)
    )


def _outcomes(folder: Path) -> None:
    log = OutcomeLog(folder / "pnp.jsonl", _KEY, "def")
    require(all(isinstance(commit, str) for commit in log.commits), f"{log.commits}")
    for o in log.outcomes:
        ids = (o.scene_id, o.ref_image_id, o.second_image_id, o.gap)
        require(all(type(i) is int for i in ids), f"{ids}")
        require(isinstance(o.object_name, str), f"{o.object_name!r}")
        numbers = [o.camera_baseline, o.visibility, o.baseline, *o.distances, o.keypoint_distance]
        require(np.isfinite(numbers).all() and min(numbers) >= 0, f"{numbers}")
        require(o.error >= 0 and all(e >= 0 for e in o.solver_errors.values()), f"{o}")


def _write_training_log(folder: Path) -> None:
    log = TrainingLog(folder / "log.jsonl")
    log("detector", 20, {"train/loss": 0.5})
    log("detector", 40, {"held_out/recall": 0.9, "held_out/distance": 2.5})
    log("features", 20, {"held_out/angle": 3.0, "train/loss": 0.25})


def _training_log(folder: Path) -> None:
    log = TrainingLog(folder / "log.jsonl", resume=True)
    for name, value in log.held_out.items():
        require(isinstance(value, int | float) and math.isfinite(value), f"{name}: {value!r}")


def _write_manifest(folder: Path) -> None:
    write_small_dataset(folder)
    check_or_write_manifest(folder / "manifest.json", _SETTINGS, {"scenes": [{"kind": "linemod"}]})


def _manifest(folder: Path) -> None:
    describe_data(folder)
    models = dataset_models(folder)
    require(models is None or all(isinstance(m, str) for m in models), f"{models}")
    StudySet.open("linemod", folder)
    check_or_write_manifest(folder / "manifest.json", _SETTINGS)


def _write_sums(folder: Path) -> None:
    write_small_dataset(folder)
    write_sums(folder / "test" / "000000")
    write_dataset_sums(folder, "test", ["models", "camera.json"])


def _sums(folder: Path) -> None:
    list(find_problems(folder))


def _write_hyperparameters(folder: Path) -> None:
    (folder / "own.yml").write_bytes(SHIPPED.read_bytes())


def _hyperparameters(folder: Path) -> None:
    for algo, env in (("ppo", "TwoViewPose-v0"), ("greedy", "TwoViewPoseReplay-v0")):
        entry = load_hyperparameters(algo, env, folder / "own.yml")
        require(isinstance(algorithm_kwargs(entry), dict), "arguments")


def _write_pack(folder: Path) -> None:
    write_small_dataset(folder)
    pack_dataset(folder, {name: solid(name) for name in SOLIDS}, split="test")


def _pack(folder: Path) -> None:
    pack = pack_dataset(folder, {name: solid(name) for name in SOLIDS}, split="test")
    for target in range(len(pack.spans)):
        require(pack.crop(target).shape == (192, 192, 3), "crop")
        require(pack.mask(target).shape == (192, 192), "mask")
        depth = pack.depth(target)
        require(depth is None or np.isfinite(depth).all(), "depth")
        pack.frame(int(pack.frame_index[target]))


RECORDS = {
    "results-json": Reader(_write_results, (_RESULTS,), _results),
    "outcome-log": Reader(_write_outcomes, ("*.jsonl",), _outcomes),
    "training-log": Reader(_write_training_log, ("*.jsonl",), _training_log),
    "manifest": Reader(_write_manifest, ("manifest.json",), _manifest),
    "checksums": Reader(_write_sums, ("**/SHA256SUMS",), _sums),
    "crop-pack": Reader(_write_pack, ("packed_test/*",), _pack),
    "hyperparameters": Reader(_write_hyperparameters, ("own.yml",), _hyperparameters),
}
