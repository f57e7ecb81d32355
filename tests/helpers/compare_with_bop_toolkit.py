"""Runs bop_toolkit on a small generated dataset, and stores the dataset and the results.

    python tests/helpers/compare_with_bop_toolkit.py --toolkit DIR --out FILE

DIR is a checkout of https://github.com/thodan/bop_toolkit; its ``inout``, ``misc``, ``pose_error``,
``pose_matching`` and ``score`` need ``imageio`` and ``pypng`` beside what this project installs.
`test_bop_toolkit` runs our functions on the stored dataset and compares with the stored results, so
it does not need the toolkit. Lengths are in millimeters, as in the toolkit.
"""

from __future__ import annotations

import argparse
import base64
import json
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.bop.results import read_bop_results, write_bop_results
from two_view_pose.pose_estimator.bop.symmetries import CONTINUOUS_SYMMETRY_STEPS

SCENE = "test/000003"
MIN_VISIBLE = 0.1
STEP = np.pi / (CONTINUOUS_SYMMETRY_STEPS - 0.5)  # the toolkit rounds up
SYMMETRIES: dict[int, dict[str, Any]] = {
    1: {},
    2: {"symmetries_continuous": [{"axis": [0.6, 0.0, 0.8], "offset": [3.0, -4.0, 7.5]}]},
    5: {"symmetries_discrete": [[-1, 0, 0, 4, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]]},
    9: {
        "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}],
        "symmetries_discrete": [[1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 5, 0, 0, 0, 1]],
    },
}


def unpack(document: dict[str, Any], root: Path) -> Path:
    """Writes the stored dataset into a folder."""
    for name, text in document["files"].items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".png":
            path.write_bytes(base64.b64decode(text))
        else:
            path.write_text(text if isinstance(text, str) else json.dumps(text))
    return root


def random_pose(rng: np.random.Generator, near: np.ndarray | None = None) -> np.ndarray:
    """A random pose (4, 4) in millimeters; with ``near``, that pose with a random error."""
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.uniform([-300, -200, 400], [300, 200, 1500]).round(3)
    if near is None:
        return T
    angle, length = [(0.02, 2), (0.05, 5), (0.3, 20), (3.0, 300)][rng.integers(4)]
    T[:3, :3] = Rotation.from_rotvec(rng.normal(size=3) * angle / 2).as_matrix()
    T[:3, 3] = (rng.normal(size=3) * length / 2).round(3)
    return near @ T


def png(pixels: np.ndarray) -> str:
    return base64.b64encode(cv2.imencode(".png", pixels)[1].tobytes()).decode()


def make_files(rng: np.random.Generator, kit: SimpleNamespace) -> dict[str, Any]:
    """Three images of four objects with masks, and models of random points."""
    files: dict[str, Any] = {}
    cameras, poses, infos = {}, {}, {}
    for image in (0, 4, 12):
        T = random_pose(rng)
        cameras[str(image)] = {
            "cam_K": [572.4114, 0, 325.2611, 0, 573.57043, 242.04899, 0, 0, 1],
            "cam_R_w2c": T[:3, :3].ravel().tolist(),
            "cam_t_w2c": T[:3, 3].tolist(),
            "depth_scale": 0.1 * (1 + image),
        }
        poses[str(image)], infos[str(image)] = [], []
        for index, obj_id in enumerate((1, 2, 5, 9, 5)):
            T = random_pose(rng)
            rotation, translation = T[:3, :3].ravel().tolist(), T[:3, 3].tolist()
            pose = {"obj_id": obj_id, "cam_R_m2c": rotation, "cam_t_m2c": translation}
            poses[str(image)].append(pose)
            amodal = np.zeros((24, 32), np.uint8)
            center, axes = rng.integers((8, 8), (24, 16)), rng.integers(3, 8, 2)
            cv2.ellipse(amodal, center.tolist(), axes.tolist(), 30, 0, 360, 255, -1)
            visible = amodal * (np.arange(32) > rng.integers(4, 18)).astype(np.uint8)
            name = f"{image:06d}_{index:06d}.png"
            files[f"{SCENE}/mask/{name}"], files[f"{SCENE}/mask_visib/{name}"] = map(
                png, (amodal, visible)
            )
            info = {"visib_fract": visible.sum() / amodal.sum(), "bbox_visib": [-1] * 4}
            info |= {"bbox_obj": [-1] * 4, "px_count_visib": 0, "px_count_all": 0}
            infos[str(image)].append(info)
        files[f"{SCENE}/rgb/{image:06d}.png"] = png(rng.integers(0, 255, (5, 6, 3), np.uint8))
        files[f"{SCENE}/depth/{image:06d}.png"] = png(rng.integers(0, 60000, (5, 6), np.uint16))
    contents = {"scene_camera": cameras, "scene_gt": poses, "scene_gt_info": infos}
    files |= {f"{SCENE}/{name}.json": content for name, content in contents.items()}
    models = {}
    for obj_id, symmetries in SYMMETRIES.items():
        points = rng.uniform(-60, 60, (30, 3)).round(3)
        lines = ["ply", "format ascii 1.0", "element vertex 30"]
        lines += [f"property double {axis}" for axis in "xyz"]
        lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
        lines += [" ".join(map(str, point)) for point in points] + ["3 0 1 2"]
        files[f"models_eval/obj_{obj_id:06d}.ply"] = "\n".join(lines) + "\n"
        low, size = points.min(axis=0), np.ptp(points, axis=0)
        models[str(obj_id)] = {"diameter": kit.misc.calc_pts_diameter(points)} | symmetries
        models[str(obj_id)] |= {f"min_{axis}": v for axis, v in zip("xyz", low, strict=True)}
        models[str(obj_id)] |= {f"size_{axis}": v for axis, v in zip("xyz", size, strict=True)}
    files["models_eval/models_info.json"] = models
    return files


def toolkit_results(kit: SimpleNamespace, root: Path, rng: np.random.Generator) -> dict[str, Any]:
    """The toolkit's results on the dataset at ``root``."""
    scene = root / SCENE
    infos = kit.inout.load_json(root / "models_eval/models_info.json", keys_to_int=True)
    points = {
        i: kit.inout.load_ply(root / f"models_eval/obj_{i:06d}.ply")["pts"] for i in SYMMETRIES
    }
    symmetries = {i: kit.misc.get_symmetry_transformations(infos[i], STEP) for i in SYMMETRIES}
    cameras = kit.inout.load_scene_camera(scene / "scene_camera.json")
    poses = kit.inout.load_scene_gt(scene / "scene_gt.json")
    answers: dict[str, Any] = {
        "points": points,
        "diameters": {i: kit.misc.calc_pts_diameter(points[i]) for i in points},
        # Rotation vectors and translations.
        "symmetries": {
            i: [
                np.r_[Rotation.from_matrix(s["R"]).as_rotvec(), s["t"].ravel()].round(8)
                for s in given
            ]
            for i, given in symmetries.items()
        },
        "images": {},
        "annotations": {},
        "errors": [errors(kit, i, points[i], symmetries[i], rng) for i in points for _ in range(4)],
    }
    for image, camera in cameras.items():
        name = f"{image:06d}.png"
        depth = kit.inout.load_depth(scene / "depth" / name) * camera["depth_scale"]
        T_cam_world = np.column_stack([camera["cam_R_w2c"], camera["cam_t_w2c"]])
        answers["images"][image] = {
            "K": camera["cam_K"], "T_cam_world": T_cam_world, "depth": depth,
            "rgb": kit.inout.load_im(scene / "rgb" / name),
        }  # fmt: skip
        answers["annotations"][image] = [
            {
                "obj_id": gt["obj_id"],
                "T_cam_obj": np.column_stack([gt["cam_R_m2c"], gt["cam_t_m2c"]]),
            }
            | masks(kit, scene, f"{image:06d}_{index:06d}.png")
            for index, gt in enumerate(poses[image])
        ]
    return answers | localization(kit, root, poses, points, rng)


def masks(kit: SimpleNamespace, scene: Path, name: str) -> dict[str, Any]:
    """Boxes, pixel counts and the visible fraction, as calc_gt_info.py measures them."""
    found: dict[str, Any] = {}
    for kind, box, count in (
        ("mask_visib", "bbox_visib", "px_count_visib"),
        ("mask", "bbox_obj", "px_count_all"),
    ):
        mask = kit.inout.load_im(scene / kind / name) > 0
        found[count] = int(mask.sum())
        rows, columns = mask.nonzero()
        found[box] = kit.misc.calc_2d_bbox(columns, rows) if mask.any() else [-1] * 4
    return found | {"visibility": found["px_count_visib"] / found["px_count_all"]}


def errors(
    kit: SimpleNamespace, obj_id: int, pts: np.ndarray, symmetries: list, rng: np.random.Generator
) -> dict[str, Any]:
    """The errors of one random estimate; degrees and millimeters."""
    T_true = random_pose(rng)
    T_est = random_pose(rng, near=T_true)
    R_e, R_g, t_e, t_g = T_est[:3, :3], T_true[:3, :3], T_est[:3, 3:], T_true[:3, 3:]
    return {
        "obj_id": obj_id, "T_est": T_est[:3], "T_true": T_true[:3],
        "add": kit.pose_error.add(R_e, t_e, R_g, t_g, pts),
        "adi": kit.pose_error.adi(R_e, t_e, R_g, t_g, pts),
        "re": kit.pose_error.re(R_e, R_g),
        "re_symmetric": min(kit.pose_error.re(R_e, R_g @ s["R"]) for s in symmetries),
    }  # fmt: skip


def localization(
    kit: SimpleNamespace, root: Path, poses: dict, points: dict, rng: np.random.Generator
) -> dict[str, Any]:
    """Targets, result files, and the recall of estimates, some of which are wrong."""
    infos = kit.inout.load_json(root / SCENE / "scene_gt_info.json", keys_to_int=True)
    targets, estimates, rows = [], [], []
    for image, gts in poses.items():
        wanted = kit.inout.get_im_targets(gts, infos[image], MIN_VISIBLE)
        targets += [[3, image, obj_id, t["inst_count"]] for obj_id, t in sorted(wanted.items())]
        for gt in gts:
            if rng.random() < 0.1:
                continue
            T = np.vstack([np.column_stack([gt["cam_R_m2c"], gt["cam_t_m2c"]]), (0, 0, 0, 1)])
            T = random_pose(rng, near=T)
            estimate = {"scene_id": 3, "im_id": image, "obj_id": gt["obj_id"]}
            score = round(rng.uniform(), 6)
            estimates.append(
                estimate | {"score": score, "R": T[:3, :3], "t": T[:3, 3:], "time": 0.25}
            )
    for _, image, obj_id, count in targets:
        of_target = [e for e in estimates if (e["im_id"], e["obj_id"]) == (image, obj_id)]
        measure = kit.pose_error.add if obj_id == 1 else kit.pose_error.adi
        size = kit.misc.calc_pts_diameter(points[obj_id])
        instances = {i: g for i, g in enumerate(poses[image]) if g["obj_id"] == obj_id}
        # As in eval_calc_errors.py, as many estimates as instances, those of the highest scores.
        for e in sorted(of_target, key=lambda e: -e["score"])[:count]:
            against = {
                i: [measure(e["R"], e["t"], g["cam_R_m2c"], g["cam_t_m2c"], points[obj_id]) / size]
                for i, g in instances.items()
            }
            visible = {i: infos[image][i]["visib_fract"] for i in instances}
            rows.append({"im_id": image, "obj_id": obj_id, "est_id": len(rows), "errors": against,
                         "score": e["score"], "gt_visib_fracts": visible})  # fmt: skip
    valid = {i: [info["visib_fract"] >= MIN_VISIBLE for info in infos[i]] for i in infos}
    matches = kit.pose_matching.match_poses_scene(3, poses, infos, valid, rows, [0.1], n_top=0)
    objects = sorted({target[2] for target in targets})
    matches = [m for m in matches if m["obj_id"] in objects]
    scores = kit.score.calc_localization_scores([3], objects, matches, 0, do_print=False)
    with tempfile.TemporaryDirectory() as scratch:
        theirs, ours = Path(scratch) / "theirs_set-test.csv", Path(scratch) / "ours_set-test.csv"
        kit.inout.save_bop_results(theirs, estimates)
        write_bop_results(ours, read_bop_results(theirs))
        accepted, message = kit.inout.check_bop_results(ours)
        if not accepted:
            raise ValueError(f"the toolkit rejects our result file: {message}")
        for row, estimate in zip(kit.inout.load_bop_results(ours), estimates, strict=True):
            assert np.allclose(row["R"], estimate["R"], rtol=0, atol=1e-9)
            assert np.allclose(row["t"], estimate["t"], rtol=0, atol=1e-9)
        texts = {"theirs": theirs.read_text(), "ours": ours.read_text()}
    recall = {"objects": scores["obj_recalls"], "mean": scores["mean_obj_recall"]}
    return {"targets": targets, "recall": recall, "result_files": texts}


def plain(value: Any) -> Any:
    """Converts NumPy arrays and numbers for JSON."""
    return value.tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    for name in ("toolkit", "out"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    options = parser.parse_args()
    sys.path.insert(0, str(options.toolkit))
    names = ("inout", "misc", "pose_error", "pose_matching", "score")
    # By name, as the toolkit is no dependency of this project.
    kit = SimpleNamespace(**{name: import_module(f"bop_toolkit_lib.{name}") for name in names})
    commit = ["git", "-C", str(options.toolkit), "rev-parse", "HEAD"]
    rng = np.random.default_rng(0)
    document: dict[str, Any] = {
        "toolkit": "https://github.com/thodan/bop_toolkit",
        "toolkit_commit": subprocess.run(commit, capture_output=True, text=True).stdout.strip(),
        "files": make_files(rng, kit),
    }
    document = json.loads(json.dumps(document, default=plain))
    with tempfile.TemporaryDirectory() as scratch:
        document["answers"] = toolkit_results(kit, unpack(document, Path(scratch)), rng)
    options.out.write_text(json.dumps(document, default=plain, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
