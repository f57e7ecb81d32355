"""The verb: every stage takes a step on a tiny dataset, and the weights load."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from two_view_pose import assets, pose_estimator
from two_view_pose.pose_estimator.crops import CropPack
from two_view_pose.pose_estimator.dataset import TrainingSet
from two_view_pose.pose_estimator.networks import PoseNetworks
from two_view_pose.pose_estimator.stages import VolumeStage
from two_view_pose.pose_estimator.training import (
    TrainEstimatorConfig,
    _describe_data,
    train_estimator,
)
from two_view_pose.pose_estimator.weights import read_header


def test_unknown_stages_are_named(tmp_path: Path):
    config = TrainEstimatorConfig(data=tmp_path, out=tmp_path / "out", stages=("features", "magic"))
    with pytest.raises(ValueError, match=r"unknown stages \['magic'\]; there are detector"):
        train_estimator(config)


def test_all_stages_end_in_weights_that_load(
    dataset: Path, pack: CropPack, boxes, tmp_path: Path, monkeypatch
):
    monkeypatch.setattr(assets, "load_objects", lambda spec: boxes)
    for name, size in (("detector", 2), ("features", 2), ("volume", 2)):
        from two_view_pose.pose_estimator import stages, training

        monkeypatch.setitem(training._STAGES[name], "batch", size)
        stage = getattr(stages, f"{'Feature' if name == 'features' else name.title()}Stage")
        monkeypatch.setattr(stage, "validate", lambda self: {"figure": 0.5})
    config = TrainEstimatorConfig(
        data=dataset, out=tmp_path / "out", detector_steps=1, feature_steps=1, volume_steps=1,
        pretrained=False, validation=0.3, threads=1, json=tmp_path / "figures.json",
    )  # fmt: skip
    path = train_estimator(config)
    assert path == tmp_path / "out" / "weights.safetensors"
    assert read_header(path)["trained_on"]["dataset"] == dataset.name
    assert pose_estimator.load("mid", path).object_names == ("brick", "crate")
    records = json.loads((tmp_path / "figures.json").read_text())["records"]
    assert {r["stage"] for r in records} == {"detector", "features", "volume"}
    again = path.read_bytes()
    train_estimator(config)  # finished: nothing is trained again
    assert path.read_bytes() == again


def test_the_header_says_how_the_data_was_made(tmp_path: Path):
    from two_view_pose.envs.generate import GenerateConfig, _claim_folder

    _claim_folder(GenerateConfig(out=tmp_path / "mine", scenes=3, seed=9), ("duck",))
    said = _describe_data(tmp_path / "mine")
    assert said["dataset"] == "mine" and said["generate"]["scenes"] == 3
    assert said["generate"]["settings"]["seed"] == 9
    assert said["generate"]["settings"]["objects"] == ["duck"]


def test_the_volume_stage_sees_one_pose_in_both_views(
    pack: CropPack, boxes, networks: PoseNetworks
):
    # Votes of the symmetric object for the other equivalent are renumbered to the trained pose.
    training = TrainingSet(pack, boxes, networks.features.config, None)
    stage = VolumeStage(networks, training, training, steps=1, batch=1, learning_rate=1.0, seed=0)
    networks.requires_grad_(True)
    truth = torch.tensor(boxes["crate"].keypoints).float()[None] + torch.tensor([0, 0, 1.0])
    projection = torch.tensor([[114.0, 0, 16, 0], [0, 114, 16, 0], [0, 0, 1, 0]])
    projection = projection.expand(1, 2, 3, 4)
    pixels = truth[0, :, :2] / truth[0, :, 2:] * 114 + 16
    other = pixels[torch.from_numpy(stage.permutations[1][1])]
    mean = torch.stack([other, pixels])[None].clone()
    covariance = torch.arange(9.0)[:, None, None].expand(9, 2, 2).expand(1, 2, 9, 2, 2).clone()
    stage._agree(mean, covariance, projection, truth, torch.tensor([1]))
    assert torch.allclose(mean[0, 0], pixels) and torch.allclose(mean[0, 1], pixels)
    assert np.array_equal(covariance[0, 0, :, 0, 0].numpy(), stage.permutations[1][1])
    assert np.array_equal(covariance[0, 1, :, 0, 0].numpy(), np.arange(9))
