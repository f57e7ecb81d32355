"""Readers of BOP datasets: scenes, models, pairs, targets, result files, and the linter."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from helpers.small_dataset import CAMERAS, SCENE, write_small_dataset
from two_view_pose.core.errors import InputError
from two_view_pose.pose_estimator.bop.dataset import BopImage, read_dataset
from two_view_pose.pose_estimator.bop.depth_unit import stored_depth_unit
from two_view_pose.pose_estimator.bop.find_pairs import find_pairs
from two_view_pose.pose_estimator.bop.models_info import read_models_info
from two_view_pose.pose_estimator.bop.objects import dataset_objects
from two_view_pose.pose_estimator.bop.pairs import PAIRS_FILE, read_pairs
from two_view_pose.pose_estimator.bop.results import BopResult, read_bop_results, write_bop_results
from two_view_pose.pose_estimator.bop.targets import TARGETS_FILE, read_targets
from two_view_pose.pose_estimator.dataset_checks.checks import find_mistakes
from two_view_pose.pose_estimator.dataset_checks.config import CheckDataConfig

from .judge import Reader, require


def check_rigid(T: np.ndarray, what: str) -> None:
    """Requires transforms (..., 4, 4) in meters with orthonormal rotations."""
    T = np.asarray(T)
    require(np.isfinite(T).all(), f"{what} is not finite: {T.tolist()}")
    R = T[..., :3, :3]
    wrong = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0)
    require(wrong < 1e-6, f"{what} is off orthonormal by {wrong}")
    require(np.linalg.det(R) > 0, f"{what} is a reflection")
    require(T[..., 3, :] == [0, 0, 0, 1], f"{what} has another last row")


def _check_image(image: BopImage) -> None:
    name = f"image {image.image_id}"
    require(np.isfinite(image.K).all() and image.K[0, 0] > 0 < image.K[1, 1], f"K of {name}")
    require(0 < image.depth_scale < 1e9, f"depth_scale {image.depth_scale} of {name}")
    if image.T_cam_world is not None:
        check_rigid(image.T_cam_world, f"T_cam_world of {name}")
    for a in image.annotations:
        check_rigid(a.T_cam_obj, f"T_cam_obj of {name}")
        require(a.obj_id >= 0, f"obj_id {a.obj_id} of {name}")
        require(0 <= a.visibility <= 1, f"visibility {a.visibility} of {name}")
        require(a.px_count_visib >= -1 <= a.px_count_all, f"pixel counts of {name}")


def _scene(root: Path) -> None:
    for image in read_dataset(root):
        _check_image(image)
        assert image.depth_path is not None
        unit = stored_depth_unit(image.depth_path)
        require(unit == image.depth_scale / 1000, f"unit {unit}, scale {image.depth_scale}")


def _models(root: Path) -> None:
    for info in read_models_info(root).values():
        name = f"object {info.obj_id}"
        require(0 < info.diameter < np.inf, f"diameter {info.diameter} of {name}")
        require(info.extents >= 0, f"size {info.extents} of {name}")
        require(np.isfinite(info.minimum), f"corner {info.minimum} of {name}")
        require(info.name is None or isinstance(info.name, str), f"name {info.name!r} of {name}")
        check_rigid(info.symmetries, f"symmetries of {name}")
    for found in dataset_objects(root).values():
        require(np.isfinite(found.points), f"points of {found.obj_id}")
        require(0 < found.diameter < np.inf, f"diameter {found.diameter} of {found.obj_id}")


def _pairs(root: Path) -> None:
    for pair in read_pairs(root):
        check_rigid(pair.T_second_ref, "T_second_ref")
        ids = (pair.scene_id, pair.ref_image_id, pair.second_image_id, *pair.obj_ids)
        require(min(ids) >= 0, f"ids {ids}")
        require(0 <= pair.baseline_deg <= 180, f"baseline {pair.baseline_deg}")
        fractions = [f for both in pair.visib_fracts.values() for f in both]
        require(all(0 <= f <= 1 for f in fractions), f"visible fractions {fractions}")


def _write_scene_pairs(root: Path) -> None:
    write_small_dataset(root)
    pair = read_pairs(root)[0]
    T = pair.T_second_ref.copy()
    T[:3, 3] *= 1000
    objects = {str(i): {"baseline_deg": angle} for i, angle in pair.baselines_deg.items()}
    entry = {"im_a": 0, "im_b": 1, "T_b_a_mm": T.ravel().tolist(), "objects": objects}
    (root / PAIRS_FILE).write_text(json.dumps({"scene_id": 0, "pairs": [entry, entry]}))


def _write_without_pairs(root: Path) -> None:
    write_small_dataset(root)
    (root / PAIRS_FILE).unlink()


def _found_pairs(root: Path) -> None:
    for pair in find_pairs(read_dataset(root)):
        check_rigid(pair.T_second_ref, "T_second_ref")
        require(0 <= pair.baseline_deg <= 180, f"baseline {pair.baseline_deg}")


def _targets(root: Path) -> None:
    for target in read_targets(read_dataset(root)):
        require(min(target) >= 0 < target.instances, f"{target}")


def _write_results(folder: Path) -> None:
    results = [BopResult(0, i, 4, 0.5 + i / 10, T, 0.1) for i, T in enumerate([*CAMERAS, *CAMERAS])]
    write_bop_results(folder / "ours_lmo-test.csv", results)


def _results(folder: Path) -> None:
    path = folder / "ours_lmo-test.csv"
    for result in read_bop_results(path):
        check_rigid(result.T_cam_obj, "T_cam_obj")
        require(min(result.target) >= 0, f"ids {result.target}")
        require(np.isfinite([result.score, result.seconds]), f"{result.score} {result.seconds}")
    read_bop_results(path, {0: {0, 1, 2, 3}}, {4})


def _linter(root: Path) -> None:
    """The linter must end, and see an error where a reader refuses to read."""
    findings, _, _ = find_mistakes(CheckDataConfig(root), root)
    findings.records()
    try:
        _scene(root), _models(root), _pairs(root)
    except (InputError, OSError) as error:
        require(findings.count("error") > 0, f"check-data finds no error, but: {error}")


_JSON = (f"{SCENE}/*.json", "models/models_info.json", PAIRS_FILE, "camera.json")

DATASETS = {
    "scene": Reader(write_small_dataset, (f"{SCENE}/*.json",), _scene),
    "models-info": Reader(write_small_dataset, ("models*/models_info.json",), _models),
    "pairs": Reader(write_small_dataset, (PAIRS_FILE,), _pairs),
    "scene-pairs": Reader(_write_scene_pairs, (PAIRS_FILE,), _pairs),
    "found-pairs": Reader(_write_without_pairs, (f"{SCENE}/*.json",), _found_pairs),
    "targets": Reader(write_small_dataset, (TARGETS_FILE,), _targets),
    "result-file": Reader(_write_results, ("*.csv",), _results),
    "check-data": Reader(write_small_dataset, (*_JSON, "models*/*.ply", "test/*/*/*.png"), _linter),
}
