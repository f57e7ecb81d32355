"""A user's mesh: images, weights, evaluation, an episode, a pose."""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import trimesh
from PIL import Image
from two_view_pose import pose_estimator
from two_view_pose.__main__ import main
from two_view_pose.core.geometry import check_rigid
from two_view_pose.core.results import read_results
from two_view_pose.pose_estimator.bop.dataset import read_dataset
from two_view_pose.pose_estimator.bop.models_info import read_models_info
from two_view_pose.pose_estimator.bop.pairs import read_pairs
from two_view_pose.pose_estimator.networks.weights import read_header
from two_view_pose.pose_estimator.training.checkpoints import read_counters
from two_view_pose.pose_estimator.training.stages import CropStage, DetectorStage
from two_view_pose.pose_estimator.training.volume_stage import VolumeStage

SMALL = "--views 2 --view-angles 10 60 --width 160 --height 120 --workers 1"


def run(command: str) -> int:
    """The exit code of a command line."""
    return main(command.split())


pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("tiny_training")]


@pytest.fixture(scope="module")
def mesh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A colored bracket in meters."""
    parts = []
    for extents, middle, color in (
        ((0.14, 0.06, 0.03), (0, 0, 0), (200, 60, 40, 255)),
        ((0.03, 0.06, 0.09), (-0.055, 0, 0.06), (60, 90, 190, 255)),
    ):
        part = trimesh.creation.box(extents).apply_translation(middle)
        part.visual = trimesh.visual.ColorVisuals(part, vertex_colors=[color] * 8)
        parts.append(part)
    path = tmp_path_factory.mktemp("parts") / "bracket.ply"
    trimesh.util.concatenate(parts).export(path)
    return path


@pytest.fixture(scope="module")
def data(mesh: Path) -> Path:
    """Training images."""
    out = mesh.parent / "bracket"
    assert run(f"generate --objects {mesh} --out {out} --scenes 3 --seed 1 {SMALL}") == 0
    return out


@pytest.fixture(scope="module")
def test_data(mesh: Path) -> Path:
    """Test images."""
    out = mesh.parent / "bracket-test"
    test = "--split test --scenes 2 --seed 2"
    assert run(f"generate --objects {mesh} --out {out} {test} {SMALL}") == 0
    return out


def training(data: Path, out: Path) -> str:
    """The command line of a training of two steps a stage, which checkpoints each of them."""
    steps = "--detector-steps 2 --decoder-steps 2 --volume-steps 2 --validation 0.34 --threads 1"
    return f"train-estimator --data {data} --out {out} --init linemod --checkpoint-every 0 {steps}"


@pytest.fixture(scope="module")
def weights(data: Path) -> Path:
    """Weights that know the bracket, if not well."""
    out = data.parent / "runs"
    assert run(training(data, out)) == 0
    return out / "weights.safetensors"


def test_generated_data_is_valid(data: Path, test_data: Path):
    assert run(f"check-data {data}") == 0
    (info,) = read_models_info(data).values()
    assert info.name == "bracket" and info.extents == pytest.approx((0.14, 0.06, 0.12), abs=1e-4)
    train, test = read_dataset(data, "train_pbr"), read_dataset(test_data, "test")
    assert train.scene_ids == (0, 1, 2) and test.scene_ids == (0, 1)
    for image in (*train, *test):
        assert image.annotation(info.obj_id) is not None
    assert len(read_pairs(test_data)) == 2
    # Another split needs another folder, and the message says so.
    assert run(f"generate --objects bracket.ply --out {data} --split test") == 2


def test_the_weights_know_the_object(weights: Path):
    header = read_header(weights)
    assert list(header["objects"]) == ["bracket"]
    # The 2D features are those of the weights it began with; only their decoder is new.
    assert header["training"]["steps"] == {"detector": 2, "decoders": 2, "volume": 2}
    assert {"detector", "features", "volume"} <= set(header["trained"])
    assert pose_estimator.load("mid", weights).object_names == ("bracket",)


def test_the_same_command_again_trains_nothing(weights: Path, data: Path, monkeypatch, capsys):
    before, header = weights.read_bytes(), read_header(weights)

    def refuse(self, batch):
        raise AssertionError("a step was trained")

    for stage in (DetectorStage, CropStage, VolumeStage):
        monkeypatch.setattr(stage, "loss", refuse)
    assert run(training(data, weights.parent)) == 0
    assert weights.read_bytes() == before and read_header(weights) == header
    printed = capsys.readouterr().out
    assert f"objects of {data / 'models'}: bracket" in printed
    assert "training bracket: detector (2 steps), decoders (2 steps), volume (2 steps)" in printed
    assert f"evaluate --method mid-pnp --weights {weights}" in printed


def test_a_killed_training_ends_with_the_same_weights(
    weights: Path, data: Path, tmp_path: Path, monkeypatch
):
    loss, calls = CropStage.loss, []

    def killed(self, batch):
        calls.append(batch)
        if len(calls) > 1:
            raise KeyboardInterrupt
        return loss(self, batch)

    monkeypatch.setattr(CropStage, "loss", killed)
    assert run(training(data, tmp_path)) == 130
    assert read_counters(tmp_path / "decoders.safetensors")["step"] == 1
    monkeypatch.setattr(CropStage, "loss", loss)
    assert run(training(data, tmp_path)) == 0
    assert (tmp_path / "weights.safetensors").read_bytes() == weights.read_bytes()


def recalls(results: Path) -> dict[str, int]:
    """How many pairs of each object a results file counts."""
    records = read_results(results)["records"]
    return {r["object"]: r["n"] for r in records if r["metric"] == "add_s_recall"}


def test_evaluation_on_the_data_and_on_new_scenes(
    weights: Path, data: Path, test_data: Path, tmp_path: Path, capsys
):
    known = f"--weights {weights} --threads 1"
    assert run(f"evaluate --data {test_data} {known} --json {tmp_path / 'data.json'}") == 0
    assert recalls(tmp_path / "data.json") == {"bracket": 2, "mean": 2}
    fresh = f"--scenes 1 {known} --cache-dir {tmp_path / 'fresh'} --json {tmp_path / 'fresh.json'}"
    assert run(f"evaluate --scene linemod {fresh}") == 0
    assert recalls(tmp_path / "fresh.json") == {"bracket": 1, "mean": 1}
    assert [info.name for info in read_models_info(tmp_path / "fresh").values()] == ["bracket"]
    # The shipped weights know nothing that these images show, and training data is no test split.
    assert run(f"evaluate --data {test_data}") == 2
    assert run(f"evaluate --data {data} {known}") == 2
    wrong = capsys.readouterr().err
    assert "shows what the weights linemod know: ape (1), " in wrong
    assert "available with --split: train_pbr" in wrong


def test_an_episode_with_the_new_weights(weights: Path, mesh: Path):
    env = gym.make(
        "two_view_pose:TwoViewPose-v0", objects=[mesh], estimator=str(weights),
        resolution=(120, 160),
    )  # fmt: skip
    observation, info = env.reset(seed=0)
    assert info["object"] == "bracket" and env.observation_space.contains(observation)
    second, reward, terminated, _, info = env.step(np.zeros(3, np.float32))
    assert env.observation_space.contains(second) and terminated and -2 < reward <= 0
    assert not np.array_equal(observation["translation"], second["translation"])
    assert np.isfinite(info["ground_truth"]["add_second"])
    env.close()
    with pytest.raises(ValueError, match=r"does not know the object\(s\) bracket"):
        gym.make("two_view_pose:TwoViewPose-v0", objects=[mesh])


def test_estimate_from_two_images(weights: Path, test_data: Path, tmp_path: Path):
    pair = read_pairs(test_data)[0]
    scene = read_dataset(test_data, "test").scene(pair.scene_id)
    first, second = scene[pair.ref_image_id], scene[pair.second_image_id]
    (tmp_path / "K.json").write_text(json.dumps({"K": first.K.tolist()}))
    (tmp_path / "T.json").write_text(json.dumps({"T_second_reference": pair.T_second_ref.tolist()}))
    images = f"--reference {first.rgb_path} --second {second.rgb_path}"
    known = f"--K {tmp_path / 'K.json'} --relative-pose {tmp_path / 'T.json'} --object bracket"
    written = f"--out {tmp_path / 'pose.json'} --overlay {tmp_path / 'overlay.png'}"
    assert run(f"estimate {images} {known} --weights {weights} {written}") == 0
    pose = json.loads((tmp_path / "pose.json").read_text())
    check_rigid(np.array(pose["T_cam_obj"]), "pose")
    assert pose["object"] == "bracket"
    assert Image.open(tmp_path / "overlay.png").size == (320, 120)
