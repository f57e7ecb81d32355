"""The weights for LM-O's objects: license, metadata and use."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from helpers.votes import check_sound
from two_view_pose import assets, pose_estimator
from two_view_pose.core.geometry import LINEMOD_K, View, make_transform
from two_view_pose.pose_estimator.networks.weights import SHIPPED, read_header
from two_view_pose.pose_estimator.visualization import ESTIMATE_COLOR, draw_poses

NAMES = ("ape", "can", "cat", "driller", "duck", "eggbox", "glue", "holepuncher")


def test_the_header_names_its_sources_and_stores_no_mesh():
    header = read_header(SHIPPED / "lmo.safetensors")
    for word in ("Hinterstoisser", "Brachmann", "BOP", "CC BY-SA 4.0"):
        assert word in header["attribution"]
    generated = header["trained_on"]["generate"]["settings"]
    assert generated["look"] == "busy" and set(generated["objects"]) == set(NAMES)
    assert (SHIPPED / "lmo.safetensors").stat().st_size <= 12e6
    stored = [path for path in (SHIPPED / "lmo_objects").rglob("*") if path.is_file()]
    assert {path.name for path in stored} == {"object.json"} and len(stored) == 8
    assert sum(path.stat().st_size for path in stored) < 40e3


def test_the_objects_are_the_eight_of_lmo():
    objects = pose_estimator.load("mid", "lmo").networks.objects
    assert tuple(objects) == NAMES
    for name, model in objects.items():
        ours = assets.load_object(name)
        assert model.obj_id == ours.obj_id and not model.has_surface
        assert np.abs(model.keypoints - ours.keypoints).max() > 1e-3
        assert model.symmetric == (name in ("eggbox", "glue"))
        assert model.diameter == pytest.approx(ours.diameter, rel=0.01)


@pytest.mark.slow
def test_noise_images_give_a_valid_pose():
    estimator = pose_estimator.load("mid", "lmo")
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (2, 480, 640, 3), dtype=np.uint8)
    aside = make_transform(np.eye(3), np.array([0.2, 0.0, 0.0]))
    views = [View(images[0], LINEMOD_K, np.eye(4)), View(images[1], LINEMOD_K, aside)]
    answer = estimator.estimate(views, "eggbox")
    check_sound(answer, 2)
    model = estimator.networks.objects["eggbox"]
    drawn = draw_poses(images[0], model, {ESTIMATE_COLOR: answer.T_cam_obj}, LINEMOD_K)
    assert drawn.shape == images[0].shape


def test_objects_without_a_mesh_cannot_be_rendered(tmp_path: Path):
    folder = SHIPPED / "lmo_objects" / "duck"
    with pytest.raises(ValueError, match=r"duck cannot be drawn.*Name its mesh file"):
        gym.make("two_view_pose:TwoViewPose-v0", objects=[str(folder)], estimator=None)
