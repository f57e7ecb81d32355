"""Errors of poses, and the recall of a file of poses, here and in BOP's toolkit."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from bop_toolkit_tally import MM, Tally
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator import metrics
from two_view_pose.pose_estimator.bop import BopDataset
from two_view_pose.pose_estimator.bop_objects import EvaluationObject, dataset_objects
from two_view_pose.pose_estimator.bop_results import BopResult
from two_view_pose.pose_estimator.bop_targets import LEAST_VISIBLE, read_targets
from two_view_pose.pose_estimator.geometry import make_transform
from two_view_pose.pose_estimator.outcomes import summarize
from two_view_pose.pose_estimator.score_results import score_results

POSE_PAIRS = 40
"""Random pairs of poses for each object."""


def compare_metrics(
    kit: SimpleNamespace, root: Path, points: dict[int, np.ndarray], tally: Tally
) -> None:
    """Errors of random poses, near and far."""
    rng = np.random.default_rng(0)
    objects = dataset_objects(root)
    infos = kit.inout.load_json(root / "models_eval" / "models_info.json", keys_to_int=True)
    for obj_id, pts in points.items():
        symmetries = kit.misc.get_symmetry_transformations(infos[obj_id], 0.01)
        for _ in range(POSE_PAIRS):
            place = rng.uniform([-0.3, -0.2, 0.4], [0.3, 0.2, 1.5])
            T_true = make_transform(Rotation.random(rng=rng).as_matrix(), place)
            T_est = T_true @ random_motion(rng, *rng.choice([(0.02, 0.002), (0.3, 0.02), (3, 0.3)]))
            R_e, R_g = T_est[:3, :3], T_true[:3, :3]
            t_e, t_g = T_est[:3, 3:] * MM, T_true[:3, 3:] * MM
            add = kit.pose_error.add(R_e, t_e, R_g, t_g, pts)
            adi = kit.pose_error.adi(R_e, t_e, R_g, t_g, pts)
            tally.add("ADD", "mm", metrics.add(T_est, T_true, pts / MM) * MM, add)
            tally.add("ADD-S (adi)", "mm", metrics.add_s(T_est, T_true, pts / MM) * MM, adi)
            ours = metrics.add_or_add_s(T_est, T_true, objects[obj_id]) * MM
            tally.add("ADD(-S) by the object", "mm", ours, adi if len(symmetries) > 1 else add)


def random_motion(rng: np.random.Generator, radians: float, metres: float) -> np.ndarray:
    """A motion (4, 4) of about that size."""
    turn = rng.normal(size=3)
    turn *= radians * rng.uniform(0.2, 1.0) / np.linalg.norm(turn)
    return make_transform(Rotation.from_rotvec(turn).as_matrix(), rng.normal(size=3) * metres / 2)


def wrong_estimates(dataset: BopDataset) -> list[BopResult]:
    """The truth, spoilt: some poses a little off, some far, some missing, some there twice."""
    rng = np.random.default_rng(1)
    results = []
    for image in dataset:
        for a in image.annotations:
            for _ in range(int(rng.choice([0, 1, 2], p=[0.15, 0.7, 0.15]))):
                T = a.T_cam_obj @ random_motion(rng, *rng.choice([(0.05, 0.005), (0.3, 0.03)]))
                numbers = (image.scene_id, image.image_id, a.obj_id)
                results.append(BopResult(*numbers, float(rng.uniform()), T, 0.25))
    return results


def compare_scores(
    kit: SimpleNamespace, dataset: BopDataset, points: dict[int, np.ndarray], tally: Tally
) -> float:
    """Targets, and the recall of spoilt poses, each side with its own matching and errors.

    Returns:
        The recall, so that a reader sees that it is neither none nor all.
    """
    objects, results = dataset_objects(dataset.root), wrong_estimates(dataset)
    targets = read_targets(dataset)
    truths = {(image.scene_id, image.image_id): image.annotations for image in dataset}
    ours = summarize(score_results(results, targets, truths, objects), {})
    found: list[tuple[int, ...]] = []
    matches: list[dict[str, Any]] = []
    for scene_id in dataset.scene_ids:
        folder = dataset.root / dataset.split / f"{scene_id:06d}"
        gt = kit.inout.load_scene_gt(folder / "scene_gt.json")
        infos = kit.inout.load_json(folder / "scene_gt_info.json", keys_to_int=True)
        for im_id in gt:
            wanted = kit.inout.get_im_targets(gt[im_id], infos[im_id], LEAST_VISIBLE)
            found += [(scene_id, im_id, o, t["inst_count"]) for o, t in wanted.items()]
        valid = {
            im_id: [info["visib_fract"] >= LEAST_VISIBLE for info in infos[im_id]] for im_id in gt
        }
        errors = toolkit_errors(kit, scene_id, gt, infos, results, objects, points)
        matches += kit.pose_matching.match_poses_scene(
            scene_id, gt, infos, valid, errors, [0.1], n_top=1
        )
    tally.add("targets", "1", sorted(targets), sorted(found))
    asked = sorted({target.obj_id for target in targets})
    seen = [m for m in matches if m["obj_id"] in asked]
    scores = kit.score.calc_localization_scores(dataset.scene_ids, asked, seen, 1, do_print=False)
    recalls = {r["object"]: r["value"] for r in ours if r["metric"] == "add_s_recall"}
    mine = [recalls[objects[obj_id].name] for obj_id in asked]
    tally.add("recall by object", "1", mine, [scores["obj_recalls"][o] for o in asked])
    tally.add("recall, mean over objects", "1", recalls["mean"], scores["mean_obj_recall"])
    return recalls["mean"]


def toolkit_errors(
    kit: SimpleNamespace,
    scene_id: int,
    gt: dict[int, list[dict[str, Any]]],
    infos: dict[int, list[dict[str, Any]]],
    results: list[BopResult],
    objects: dict[int, EvaluationObject],
    points: dict[int, np.ndarray],
) -> list[dict[str, Any]]:
    """ADD or ADI in diameters of each estimate of a scene, as its pose matching takes them."""
    rows = []
    for est_id, result in enumerate(results):
        if result.scene_id != scene_id:
            continue
        model = objects[result.obj_id]
        measure = kit.pose_error.adi if model.symmetric else kit.pose_error.add
        T, pts = result.T_cam_obj, points[result.obj_id]
        of_object = [
            (i, g) for i, g in enumerate(gt[result.image_id]) if g["obj_id"] == result.obj_id
        ]
        errors = {}
        for i, g in of_object:
            e = measure(T[:3, :3], T[:3, 3:] * MM, g["cam_R_m2c"], g["cam_t_m2c"], pts)
            errors[i] = [e / (model.diameter * MM)]
        visible = {i: infos[result.image_id][i]["visib_fract"] for i, _ in of_object}
        rows.append(
            {"im_id": result.image_id, "obj_id": result.obj_id, "est_id": est_id,
             "score": result.score, "errors": errors, "gt_visib_fracts": visible}
        )  # fmt: skip
    return rows
