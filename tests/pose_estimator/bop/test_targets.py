"""Targets of a test split: visible objects and their number of instances."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from two_view_pose.core.geometry import LINEMOD_K, make_transform
from two_view_pose.pose_estimator.bop import dataset as bop
from two_view_pose.pose_estimator.bop.boxes import NO_BOX
from two_view_pose.pose_estimator.bop.targets import is_test, write_targets
from two_view_pose.pose_estimator.bop.writer import BopFrame, write_scene


def frame(image_id: int, *seen: tuple[int, float]) -> BopFrame:
    """A gray image of objects (id, visible fraction)."""
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 1.0]))
    return BopFrame(
        rgb=np.full((8, 8, 3), 128, dtype=np.uint8),
        K=LINEMOD_K,
        T_cam_world=None,
        annotations=[bop.BopAnnotation(i, T, v, NO_BOX, NO_BOX, 0, 0) for i, v in seen],
        image_id=image_id,
    )


def test_targets_count_visible_instances(tmp_path: Path) -> None:
    write_scene(tmp_path, "test", 4, [frame(0, (7, 0.1), (2, 0.0999)), frame(3, (2, 0.0))])
    write_scene(tmp_path, "test", 2, [frame(1, (7, 0.5), (3, 1.0), (7, 0.2), (7, 0.05))])
    dataset = bop.read_dataset(tmp_path, "test")
    write_targets(dataset)
    targets = json.loads((tmp_path / "test_targets_bop19.json").read_text())
    assert targets == [
        {"scene_id": 2, "im_id": 1, "obj_id": 3, "inst_count": 1},
        {"scene_id": 2, "im_id": 1, "obj_id": 7, "inst_count": 2},
        {"scene_id": 4, "im_id": 0, "obj_id": 7, "inst_count": 1},
    ]
    write_targets(dataset, [4])
    assert json.loads((tmp_path / "test_targets_bop19.json").read_text()) == targets[2:]


def test_only_test_splits_have_targets() -> None:
    assert is_test("test") and is_test("test_kinect")
    assert not any(map(is_test, ("train_pbr", "val", "testing")))
