"""The command: every stage takes a step on a tiny dataset, and the weights load."""

import copy
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from helpers.boxes import box_depth
from safetensors.torch import load_file
from two_view_pose import assets, pose_estimator
from two_view_pose.pose_estimator.bop.dataset import read_dataset, read_mask, read_rgb
from two_view_pose.pose_estimator.bop.writer import BopFrame, write_scene
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.weights import read_header, save_weights
from two_view_pose.pose_estimator.training import optimizer, trainer
from two_view_pose.pose_estimator.training import train_estimator as training
from two_view_pose.pose_estimator.training.cascade_stage import CascadeStage
from two_view_pose.pose_estimator.training.config import STAGE_DEFAULTS, TrainEstimatorConfig
from two_view_pose.pose_estimator.training.point_stage import PointStage
from two_view_pose.pose_estimator.training.record import describe_data
from two_view_pose.pose_estimator.training.stages import DecoderStage, DetectorStage, FeatureStage
from two_view_pose.pose_estimator.training.train_estimator import train_estimator
from two_view_pose.pose_estimator.training.volume_stage import VolumeStage
from two_view_pose.pose_estimator.training_data.crops import CropPack
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet

pytestmark = pytest.mark.slow


def test_unknown_stages_are_an_error(tmp_path: Path):
    with pytest.raises(ValueError, match=r"unknown stages \['magic'\]; there are detector"):
        TrainEstimatorConfig(data=tmp_path, out=tmp_path / "out", stages=("features", "magic"))


def test_all_stages_end_in_weights_that_load(
    dataset: Path, pack: CropPack, boxes, tmp_path: Path, monkeypatch
):
    monkeypatch.setattr(assets, "load_objects", lambda spec, load=None: boxes)
    stages = {
        "detector": DetectorStage, "features": FeatureStage, "decoders": DecoderStage,
        "volume": VolumeStage,
    }  # fmt: skip
    for name, stage in stages.items():
        monkeypatch.setitem(STAGE_DEFAULTS, name, replace(STAGE_DEFAULTS[name], batch=2))
        monkeypatch.setattr(stage, "validate", lambda self: {"figure": 0.5})
    config = TrainEstimatorConfig(
        data=dataset, out=tmp_path / "out", detector_steps=1, feature_steps=1, decoder_steps=1,
        volume_steps=1, pretrained=False, validation=0.3, threads=1, workers=0,
        json=tmp_path / "figures.json",
    )  # fmt: skip
    path = train_estimator(config)
    assert path == tmp_path / "out" / "weights.safetensors"
    assert read_header(path)["trained_on"]["dataset"] == dataset.name
    assert pose_estimator.load("mid", path).object_names == ("brick", "crate")
    records = json.loads((tmp_path / "figures.json").read_text())["records"]
    assert {r["stage"] for r in records} == set(stages)
    assert read_header(path)["training"]["steps"] == dict.fromkeys(stages, 1)
    assert pose_estimator.load("mid", path).networks.config.features.own_decoders
    again, header = path.read_bytes(), read_header(path)
    assert header["held_out"] == {f"{stage}/figure": 0.5 for stage in stages}
    train_estimator(config)  # finished: nothing is trained again
    assert path.read_bytes() == again and read_header(path) == header


def test_max_minutes_writes_weights_and_resumes(
    dataset: Path, pack: CropPack, boxes, tmp_path: Path, monkeypatch, capsys
):
    monkeypatch.setattr(assets, "load_objects", lambda spec, load=None: boxes)
    for name, stage in (("detector", DetectorStage), ("features", FeatureStage)):
        monkeypatch.setitem(STAGE_DEFAULTS, name, replace(STAGE_DEFAULTS[name], batch=2))
        monkeypatch.setattr(stage, "validate", lambda self: {"figure": 0.5})
    monkeypatch.setattr(optimizer, "MIN_SIDE", 10**9)  # AdamW alone, which is quicker
    minutes = 0.0
    clock = SimpleNamespace(monotonic=lambda: 60 * minutes)
    for module in (training, trainer):
        monkeypatch.setattr(module, "time", clock)
    loss = DetectorStage.loss

    def a_minute(self, batch: dict) -> tuple:
        nonlocal minutes
        minutes += 1
        return loss(self, batch)

    monkeypatch.setattr(DetectorStage, "loss", a_minute)

    def run(out: str, **options) -> Path:
        return train_estimator(
            TrainEstimatorConfig(
                data=dataset, out=tmp_path / out, stages=("detector", "features"), threads=1,
                detector_steps=2, feature_steps=1, pretrained=False, validation=0.3, workers=0,
                device="cpu", **options,
            )
        )  # fmt: skip

    path = run("budget", max_minutes=0.5)
    header = read_header(path)
    assert header["training"]["steps"] == {"detector": 1} and header["trained"] == ["detector"]
    printed = capsys.readouterr().out
    assert "stopped after 0.5 minutes; the same command resumes with detector (1 of 2" in printed
    assert "features (0 of 1 steps)" in printed and "on cpu in" in printed
    run("budget", max_minutes=1.5)
    assert read_header(path)["training"]["steps"] == {"detector": 2, "features": 1}
    assert "stopped" not in capsys.readouterr().out
    whole = load_file(run("whole"))
    assert all(torch.equal(tensor, whole[name]) for name, tensor in load_file(path).items())


@pytest.fixture
def dataset_with_depth(dataset: Path, boxes, tmp_path: Path) -> Path:
    """Two images of each of two scenes, with the depth of the boxes alone."""
    models = {model.obj_id: model for model in boxes.values()}
    source = read_dataset(dataset, "train_pbr")
    for scene_id in source.scene_ids[:2]:
        frames = []
        for image in list(source.scene(scene_id).values())[:2]:
            depth = np.full((480, 640), np.inf)
            for a in image.annotations:
                box = box_depth(models[a.obj_id], a.T_cam_obj, image.K, depth.shape)
                depth = np.where(box > 0, np.minimum(depth, box), depth)
            frames.append(
                BopFrame(
                    read_rgb(image), image.K, image.T_cam_world, image.annotations,
                    [read_mask(a) for a in image.annotations],
                    np.where(np.isfinite(depth), depth, 0),
                )
            )  # fmt: skip
        write_scene(tmp_path / "deep", "train_pbr", scene_id, frames)
    return tmp_path / "deep"


@pytest.mark.parametrize(
    ("part", "stage", "method", "other"),
    [("cascade", CascadeStage, "early", "rgbd"), ("points", PointStage, "rgbd", "early")],
)
def test_a_part_is_added_to_trained_weights(
    part, stage, method, other,
    dataset_with_depth: Path, boxes, networks: PoseNetworks, tmp_path: Path, monkeypatch,
):  # fmt: skip
    monkeypatch.setattr(assets, "load_objects", lambda spec, load=None: boxes)
    monkeypatch.setitem(STAGE_DEFAULTS, part, replace(STAGE_DEFAULTS[part], batch=1))
    monkeypatch.setattr(stage, "validate", lambda self: {"figure": 0.5})
    finished = copy.copy(networks)
    finished.trained = frozenset({"detector", "features", "volume"})
    first = tmp_path / "first.safetensors"
    save_weights(finished, first, {"what": "three parts", "trained_on": "boxes"})
    config = TrainEstimatorConfig(
        data=dataset_with_depth, out=tmp_path / "out", stages=(part,), init=str(first),
        cascade_steps=1, points_steps=1, validation=0.3, threads=1, workers=0,
    )  # fmt: skip
    path = train_estimator(config)
    header = read_header(path)
    assert header["trained"] == ["detector", "features", "volume", part]
    assert header["training"]["steps"] == {part: 1}
    assert header["started_from"]["trained_on"] == "boxes"
    before, after = load_file(first), load_file(path)
    assert all(torch.equal(before[name], after[name]) for name in before)
    added = [name for name in after if name not in before]
    assert added and all(name.startswith(f"{part}.") for name in added)
    assert pose_estimator.load(method, path).object_names == ("brick", "crate")
    with pytest.raises(ValueError, match=f"lack what '{other}' needs"):
        pose_estimator.load(other, path)


def test_new_features_invalidate_the_cascade(
    dataset_with_depth: Path, boxes, networks: PoseNetworks, tmp_path: Path, monkeypatch
):
    monkeypatch.setattr(assets, "load_objects", lambda spec, load=None: boxes)
    monkeypatch.setattr(trainer, "run_stage", lambda stage, loop, log: 1)
    finished = copy.copy(networks)
    finished.trained = frozenset({"detector", "features", "cascade"})
    save_weights(finished, tmp_path / "first.safetensors", {})
    config = TrainEstimatorConfig(
        data=dataset_with_depth, out=tmp_path / "out", stages=("features",), feature_steps=1,
        init=str(tmp_path / "first.safetensors"), validation=0.3, threads=1, workers=0,
    )  # fmt: skip
    assert read_header(train_estimator(config))["trained"] == ["detector", "features"]


def test_describe_data_holds_the_generate_settings(tmp_path: Path):
    from two_view_pose.envs.datagen.generate import GenerateConfig, write_manifest

    write_manifest(GenerateConfig(out=tmp_path / "mine", scenes=3, seed=9), ("duck",))
    said = describe_data(tmp_path / "mine")
    assert said["dataset"] == "mine" and said["generate"]["scenes"] == 3
    assert said["generate"]["settings"]["seed"] == 9
    assert said["generate"]["settings"]["objects"] == ["duck"]


def test_relabel_votes_of_a_symmetric_object(pack: CropPack, boxes, networks: PoseNetworks):
    # Votes of the symmetric object for the other equivalent are renumbered to the trained pose.
    training = TrainingSet(pack, boxes, networks.features.config, None)
    stage = VolumeStage(networks, training, training, steps=1, batch=1, learning_rate=1.0, seed=0)
    networks.requires_grad_(True)
    truth = torch.tensor(boxes["crate"].keypoints).float()[None] + torch.tensor([0, 0, 1.0])
    projection = torch.tensor([[114.0, 0, 16, 0], [0, 114, 16, 0], [0, 0, 1, 0]])
    projection = projection.expand(1, 2, 3, 4)
    pixels = truth[0, :, :2] / truth[0, :, 2:] * 114 + 16
    other = pixels[stage.permutations[1, 1]]
    mean = torch.stack([other, pixels])[None].clone()
    covariance = torch.arange(9.0)[:, None, None].expand(9, 2, 2).expand(1, 2, 9, 2, 2).clone()
    mean, covariance = stage.relabel_votes(mean, covariance, projection, truth, torch.tensor([1]))
    assert torch.allclose(mean[0, 0], pixels) and torch.allclose(mean[0, 1], pixels)
    assert torch.equal(covariance[0, 0, :, 0, 0], stage.permutations[1, 1].float())
    assert np.array_equal(covariance[0, 1, :, 0, 0].numpy(), np.arange(9))
