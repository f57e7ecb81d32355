"""Compares what we read, write and measure with BOP's own toolkit.

    python tests/pose_estimator/compare_with_bop_toolkit.py --toolkit DIR --data DIR --out FILE

DIR of the toolkit is a checkout of https://github.com/thodan/bop_toolkit; its ``inout``, ``misc``,
``pose_error``, ``pose_matching`` and ``score`` need ``imageio`` and ``pypng`` beside what this
project installs. The data is a test split that ``generate --depth --jpeg-quality 0`` wrote, with
masks. Each figure is the largest absolute difference between the two, in the unit that it says;
none may exceed `LIMIT`. Counts are of numbers compared.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from bop_toolkit_measures import POSE_PAIRS, compare_metrics, compare_scores, wrong_estimates
from bop_toolkit_tally import MM, Tally
from two_view_pose.assets import surface
from two_view_pose.pose_estimator.bop import BopDataset, read_dataset, read_depth, read_rgb
from two_view_pose.pose_estimator.bop_models_info import (
    CONTINUOUS_SYMMETRY_STEPS,
    read_models_info,
)
from two_view_pose.pose_estimator.bop_objects import dataset_objects
from two_view_pose.pose_estimator.bop_results import (
    read_bop_results,
    write_bop_results,
)
from two_view_pose.pose_estimator.geometry import make_transform
from two_view_pose.pose_estimator.results import versions

LIMIT = 1e-6

NOT_COMPARED = {
    "pose_error.mssd, mspd, proj": "this project has no such measures",
    "pose_error.vsd, visibility.estimate_visib_mask_gt": "need the toolkit's renderer (EGL); the "
    "visible fractions are recomputed from the masks instead",
    "visible fractions and whole boxes of objects that reach the picture's edge": "their hidden "
    "part lies outside of the masks",
}


def load_toolkit(folder: Path) -> SimpleNamespace:
    """The modules of a checkout."""
    sys.path.insert(0, str(folder))
    names = ("inout", "misc", "pose_error", "pose_matching", "score")
    # By name, as the toolkit is no dependency of this project.
    modules = {name: import_module(f"bop_toolkit_lib.{name}") for name in names}
    return SimpleNamespace(**modules)


def compare_scenes(kit: SimpleNamespace, dataset: BopDataset, tally: Tally) -> None:
    """Poses, cameras, pictures, depth, and scene_gt_info.json from the masks."""
    for scene_id in dataset.scene_ids:
        folder = dataset.root / dataset.split / f"{scene_id:06d}"
        cameras = kit.inout.load_scene_camera(folder / "scene_camera.json")
        poses = kit.inout.load_scene_gt(folder / "scene_gt.json")
        for image_id, image in dataset.scene(scene_id).items():
            camera = cameras[image_id]
            tally.add("camera matrix", "px", image.K, camera["cam_K"])
            assert image.T_cam_world is not None and image.depth_path is not None
            tally.poses(
                "world to camera", image.T_cam_world, camera["cam_R_w2c"], camera["cam_t_w2c"]
            )
            tally.add("picture", "grey level", read_rgb(image), kit.inout.load_im(image.rgb_path))
            depth = kit.inout.load_depth(image.depth_path).astype(np.float64)
            depth *= camera["depth_scale"] / MM
            tally.add("depth map (float32)", "m", read_depth(image), depth)
            tally.add("annotations of a picture", "1", len(image.annotations), len(poses[image_id]))
            for i, (ours, theirs) in enumerate(
                zip(image.annotations, poses[image_id], strict=True)
            ):
                tally.add("object id", "1", ours.obj_id, theirs["obj_id"])
                tally.poses(
                    "object to camera", ours.T_cam_obj, theirs["cam_R_m2c"], theirs["cam_t_m2c"]
                )
                name = f"{image_id:06d}_{i:06d}.png"
                visible, whole = (
                    kit.inout.load_im(folder / kind / name) > 0 for kind in ("mask_visib", "mask")
                )
                compare_masks(kit, ours, visible, whole, tally)


def compare_masks(
    kit: SimpleNamespace, ours: Any, visible: np.ndarray, whole: np.ndarray, tally: Tally
) -> None:
    """What scene_gt_info.json says, against the masks as calc_gt_info.py measures them."""
    tally.add("visible pixels", "px", ours.px_count_visib, visible.sum())
    if visible.any():
        rows, columns = visible.nonzero()
        tally.add("visible box", "px", ours.bbox_visib, kit.misc.calc_2d_bbox(columns, rows))
    edge = np.ones_like(whole)
    edge[1:-1, 1:-1] = False
    if not (whole & edge).any() and whole.any():
        rows, columns = whole.nonzero()
        tally.add("whole box", "px", ours.bbox_obj, kit.misc.calc_2d_bbox(columns, rows))
        tally.add("visible fraction", "1", ours.visibility, visible.sum() / float(whole.sum()))


def compare_models(kit: SimpleNamespace, root: Path, tally: Tally) -> dict[int, np.ndarray]:
    """Points, diameters and symmetries; returns the points of models_eval in millimetres."""
    points = {}
    objects = dataset_objects(root)
    for folder in ("models", "models_eval"):
        infos = kit.inout.load_json(root / folder / "models_info.json", keys_to_int=True)
        ours = read_models_info(root, folder)
        tally.add("ids of models", "1", sorted(ours), sorted(infos))
        for obj_id, info in infos.items():
            theirs = kit.inout.load_ply(root / folder / f"obj_{obj_id:06d}.ply")["pts"]
            mine = ours[obj_id]
            tally.add("diameter as read", "mm", mine.diameter * MM, info["diameter"])
            lowest = [info[f"min_{axis}"] for axis in "xyz"]
            sizes = [info[f"size_{axis}"] for axis in "xyz"]
            tally.add("bounding box as read", "mm", mine.minimum * MM, lowest)
            tally.add("bounding box as read", "mm", mine.extents * MM, sizes)
            compare_symmetries(kit, mine.symmetries, info, tally)
            measured = kit.misc.calc_pts_diameter(theirs)
            tally.add("diameter as measured", "mm", surface.diameter(theirs / MM) * MM, measured)
            if folder == "models":  # models_eval is simpler than what the diameter is of
                # The PLY holds float32.
                tally.add("diameter written, of the mesh", "m", mine.diameter, measured / MM)
            else:
                tally.add("points", "mm", objects[obj_id].points * MM, theirs)
                points[obj_id] = theirs
    return points


def compare_axes(kit: SimpleNamespace, tally: Tally) -> None:
    """Continuous symmetries, which our objects lack: a vase, and a can that may be upside down."""
    size = {f"min_{axis}": -40.0 for axis in "xyz"} | {f"size_{axis}": 80.0 for axis in "xyz"}
    tilted = {"axis": [0.6, 0.0, 0.8], "offset": [3.0, -4.0, 7.5]}
    flip = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 5, 0, 0, 0, 1]
    upright = {"axis": [0, 0, 1], "offset": [0, 0, 0]}
    vase = {"diameter": 100.0, "symmetries_continuous": [tilted], **size}
    can = vase | {"symmetries_continuous": [upright], "symmetries_discrete": [flip]}
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "models" / "models_info.json"
        path.parent.mkdir()
        path.write_text(json.dumps({"1": vase, "2": can}))
        infos = kit.inout.load_json(path, keys_to_int=True)
        for obj_id, mine in read_models_info(scratch).items():
            compare_symmetries(kit, mine.symmetries, infos[obj_id], tally)


def compare_symmetries(
    kit: SimpleNamespace, ours: np.ndarray, info: dict[str, Any], tally: Tally
) -> None:
    """Both sets of transforms, whatever their order."""
    step = np.pi / (CONTINUOUS_SYMMETRY_STEPS - 0.5)  # the toolkit rounds up
    given = kit.misc.get_symmetry_transformations(info, step)
    theirs = np.stack([make_transform(s["R"], np.ravel(s["t"])) for s in given])
    ours = ours.copy()
    ours[:, :3, 3] *= MM
    tally.add("number of symmetries", "1", len(ours), len(theirs))
    apart = np.abs(ours[:, None] - theirs[None]).max(axis=(-1, -2))
    nearest = apart.argmin(axis=1)
    tally.add("symmetries (each its own)", "1", len(set(nearest.tolist())), len(ours))
    tally.add("symmetries, rotation", "1", ours[:, :3, :3], theirs[nearest, :3, :3])
    tally.add("symmetries, translation", "mm", ours[:, :3, 3], theirs[nearest, :3, 3])


def compare_results(kit: SimpleNamespace, dataset: BopDataset, tally: Tally) -> None:
    """Result files: ours in the toolkit, the toolkit's in ours."""
    results = wrong_estimates(dataset)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "ours_set-test.csv"
        write_bop_results(path, results)
        accepted, message = kit.inout.check_bop_results(path)
        if not accepted:
            raise ValueError(f"the toolkit refuses our result file: {message}")
        theirs = kit.inout.load_bop_results(path)
        kit.inout.save_bop_results(Path(scratch) / "theirs_set-test.csv", theirs)
        again = read_bop_results(Path(scratch) / "theirs_set-test.csv")
    for kind, ours in (("written", results), ("read", again)):
        for mine, row in zip(ours, theirs, strict=True):
            tally.poses(f"result file {kind}", mine.T_cam_obj, row["R"], row["t"])
            other = [row[name] for name in ("scene_id", "im_id", "obj_id", "score", "time")]
            numbers = [*mine.target, mine.score, mine.seconds]
            tally.add(f"result file {kind}, ids, score, time", "1", numbers, other)


def compare(toolkit: Path, data: Path) -> dict[str, Any]:
    """The whole comparison, as the document that is written."""
    kit, dataset, tally = load_toolkit(toolkit), read_dataset(data), Tally()
    compare_scenes(kit, dataset, tally)
    points = compare_models(kit, data, tally)
    compare_axes(kit, tally)
    compare_metrics(kit, data, points, tally)
    compare_results(kit, dataset, tally)
    recall = compare_scores(kit, dataset, points, tally)
    commit = subprocess.run(
        ["git", "-C", str(toolkit), "rev-parse", "HEAD"], capture_output=True, text=True
    )
    images = list(dataset)
    return {
        "toolkit": "https://github.com/thodan/bop_toolkit",
        "toolkit_commit": commit.stdout.strip(),
        "versions": {**versions(), "numpy": np.__version__},
        "data": {
            "scenes": len(dataset.scene_ids),
            "pictures": len(images),
            "annotations": sum(len(image.annotations) for image in images),
            "objects": len(points),
        },
        "pose_pairs_an_object": POSE_PAIRS,
        "recall_of_spoilt_poses": recall,
        "limit": LIMIT,
        "records": tally.records(),
        "not_compared": NOT_COMPARED,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    for name in ("toolkit", "data", "out"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    options = parser.parse_args()
    document = compare(options.toolkit, options.data)
    options.out.write_text(json.dumps(document, indent=1) + "\n")
    for record in document["records"]:
        line = f"{record['quantity']:<40} {record['largest_difference']:.3g} {record['unit']}"
        print(f"{line}  ({record['count']} numbers)")
    return int(any(r["largest_difference"] > LIMIT for r in document["records"]))


if __name__ == "__main__":
    sys.exit(main())
