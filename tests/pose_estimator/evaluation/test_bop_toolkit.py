"""Reading, writing and metrics against the stored outputs of bop_toolkit.

``helpers/compare_with_bop_toolkit.py`` runs the toolkit again.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import compare_with_bop_toolkit
from helpers.compare_with_bop_toolkit import SCENE, unpack
from scipy.spatial.transform import Rotation
from two_view_pose.assets import surface
from two_view_pose.core.geometry import make_transform
from two_view_pose.pose_estimator.bop.dataset import read_dataset, read_depth, read_mask, read_rgb
from two_view_pose.pose_estimator.bop.objects import dataset_objects
from two_view_pose.pose_estimator.bop.results import read_bop_results, write_bop_results
from two_view_pose.pose_estimator.bop.targets import read_targets
from two_view_pose.pose_estimator.evaluation import metrics
from two_view_pose.pose_estimator.evaluation.score_results import score_results

KEPT = json.loads(Path(compare_with_bop_toolkit.__file__).with_name("bop_toolkit.json").read_text())
ANSWERS = KEPT["answers"]
MM = 1000.0
close = np.testing.assert_allclose
EXACT: dict[str, Any] = {"rtol": 0, "atol": 1e-9}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return unpack(KEPT, tmp_path_factory.mktemp("kept"))


def pose(rows: list[list[float]]) -> np.ndarray:
    """A transform (4, 4) in meters from the toolkit's (3, 4) in millimeters."""
    T = np.vstack([rows, (0, 0, 0, 1)])
    T[:3, 3] /= MM
    return T


def test_cameras_images_and_depth_are_read_alike(root):
    scene = read_dataset(root).scene(3)
    assert [str(i) for i in scene] == list(ANSWERS["images"]) and len(scene) == 3
    for image_id, image in scene.items():
        theirs = ANSWERS["images"][str(image_id)]
        close(image.K, theirs["K"], **EXACT)
        close(image.T_cam_world, pose(theirs["T_cam_world"]), **EXACT)
        close(read_depth(image) * MM, theirs["depth"], rtol=1e-6)  # ours is float32
        np.testing.assert_array_equal(read_rgb(image), theirs["rgb"])


def test_without_scene_gt_info_the_masks_are_measured_alike(tmp_path):
    unpack(KEPT, tmp_path)
    (tmp_path / SCENE / "scene_gt_info.json").unlink()
    for image_id, image in read_dataset(tmp_path).scene(3).items():
        for ours, theirs in zip(
            image.annotations, ANSWERS["annotations"][str(image_id)], strict=True
        ):
            close(ours.T_cam_obj, pose(theirs["T_cam_obj"]), **EXACT)
            for name in ("obj_id", "px_count_visib", "px_count_all"):
                assert getattr(ours, name) == theirs[name]
            assert read_mask(ours).sum() == theirs["px_count_visib"]
            assert ours.visibility == pytest.approx(theirs["visibility"], abs=1e-12)
            assert list(ours.bbox_visib) == theirs["bbox_visib"]
            assert list(ours.bbox_obj) == theirs["bbox_obj"]


def test_points_diameters_and_symmetries_are_the_same(root):
    objects = dataset_objects(root)
    assert [str(i) for i in objects] == list(ANSWERS["points"])
    for obj_id, model in objects.items():
        close(model.points * MM, ANSWERS["points"][str(obj_id)], **EXACT)
        measured = ANSWERS["diameters"][str(obj_id)]
        close([model.diameter * MM, surface.diameter(model.points) * MM], measured, **EXACT)
        given = np.array(ANSWERS["symmetries"][str(obj_id)])
        theirs = np.stack(
            [make_transform(Rotation.from_rotvec(g[:3]).as_matrix(), g[3:] / MM) for g in given]
        )
        assert len(model.symmetries) == len(theirs) == {1: 1, 2: 72, 5: 2, 9: 144}[obj_id]
        # Whatever their order.
        apart = np.abs(model.symmetries[:, None] - theirs).max(axis=(-1, -2))
        assert sorted(apart.argmin(axis=1)) == list(range(len(theirs)))
        assert apart.min(axis=1).max() < 1e-7


def test_errors_of_poses_are_the_same(root):
    objects = dataset_objects(root)
    assert len(ANSWERS["errors"]) == 16
    for case in ANSWERS["errors"]:
        model, T_est, T_true = objects[case["obj_id"]], pose(case["T_est"]), pose(case["T_true"])
        add, add_s = (f(T_est, T_true, model.points) * MM for f in (metrics.add, metrics.add_s))
        close([add, add_s], [case["add"], case["adi"]], rtol=1e-6)
        either = metrics.add_or_add_s(T_est, T_true, model) * MM
        close(either, case["add" if case["obj_id"] == 1 else "adi"], rtol=1e-6)
        equivalents = T_true @ model.symmetries
        apart = Rotation.from_matrix(T_est[:3, :3].T @ equivalents[:, :3, :3]).magnitude()
        close(np.degrees([apart[0], apart.min()]), [case["re"], case["re_symmetric"]], atol=1e-6)


def test_result_files_are_written_and_read_alike(tmp_path):
    theirs, ours = tmp_path / "theirs.csv", tmp_path / "ours.csv"
    theirs.write_text(ANSWERS["result_files"]["theirs"])
    results = read_bop_results(theirs)
    assert len(results) >= 10
    # The toolkit accepted this very text and read the same poses from it.
    write_bop_results(ours, results)
    for line, kept in zip(
        ours.read_text().splitlines(), ANSWERS["result_files"]["ours"].splitlines(), strict=True
    ):
        if line != kept:
            numbers, others = (np.array(x.replace(",", " ").split(), float) for x in (line, kept))
            close(numbers, others, **EXACT)
    ours.write_text(ANSWERS["result_files"]["ours"])
    for mine, other in zip(read_bop_results(ours), results, strict=True):
        assert (mine.target, mine.score, mine.seconds) == (other.target, other.score, other.seconds)
        close(mine.T_cam_obj, other.T_cam_obj, **EXACT)


def test_targets_and_recall_are_the_same(root, tmp_path):
    dataset, objects = read_dataset(root), dataset_objects(root)
    targets = read_targets(dataset)
    assert [list(target) for target in targets] == ANSWERS["targets"]
    path = tmp_path / "theirs.csv"
    path.write_text(ANSWERS["result_files"]["theirs"])
    truths = {(image.scene_id, image.image_id): image.annotations for image in dataset}
    outcomes = score_results(read_bop_results(path), targets, truths, objects)
    recalls = {}
    for obj_id, expected in ANSWERS["recall"]["objects"].items():
        found = [o.error < 0.1 for o in outcomes if o.object_name == objects[int(obj_id)].name]
        recalls[obj_id] = np.mean(found)
        assert recalls[obj_id] == pytest.approx(expected)
    assert np.mean(list(recalls.values())) == pytest.approx(ANSWERS["recall"]["mean"])
    assert 0.1 < ANSWERS["recall"]["mean"] < 0.9
