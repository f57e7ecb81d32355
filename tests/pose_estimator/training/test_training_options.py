"""Options of ``train-estimator``: what is trained, and from which weights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from two_view_pose import assets, pose_estimator
from two_view_pose.pose_estimator.networks import weights as weights_module
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.volume import PRESETS, LevelConfig
from two_view_pose.pose_estimator.networks.weights import read_header, read_networks, save_weights
from two_view_pose.pose_estimator.training import config as training_config
from two_view_pose.pose_estimator.training.config import TrainEstimatorConfig
from two_view_pose.pose_estimator.training.stages import DecoderStage
from two_view_pose.pose_estimator.training.train_estimator import (
    start_networks,
    train_estimator,
)
from two_view_pose.pose_estimator.training.volume_stage import VolumeStage
from two_view_pose.pose_estimator.training_data.crops import CropPack
from two_view_pose.pose_estimator.training_data.cut_and_paste import CropPaster, CutAndPasteConfig
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet


@pytest.fixture
def finished(boxes, tmp_path: Path) -> Path:
    """Weights of all three parts, with the preset ``fast``."""
    torch.manual_seed(0)
    networks = PoseNetworks(boxes)
    networks.trained = frozenset({"detector", "features", "volume"})
    save_weights(networks, tmp_path / "finished.safetensors", {"what": "test"})
    return tmp_path / "finished.safetensors"


def quick(monkeypatch, boxes) -> None:
    """Makes a training take a second."""
    monkeypatch.setattr(assets, "load_objects", lambda spec, load=None: boxes)
    monkeypatch.setattr(VolumeStage, "validate", lambda self: {"figure": 0.5})
    one = replace(training_config.PAPER_VOLUME, batch=1)
    monkeypatch.setitem(training_config.STAGE_DEFAULTS, "volume", one)
    monkeypatch.setattr(training_config, "PAPER_VOLUME", one)


@pytest.mark.slow
def test_a_paper_volume_is_trained_on_trained_features(
    dataset: Path, pack: CropPack, boxes, finished: Path, tmp_path: Path, monkeypatch, capsys
):
    quick(monkeypatch, boxes)
    # The paper's but for the number of voxels.
    coarse = replace(PRESETS["paper"].coarse, cells=6)
    fine = LevelConfig(cells=None, half_size=0.65, cell_size=0.03)
    monkeypatch.setitem(PRESETS, "paper", replace(PRESETS["paper"], coarse=coarse, fine=fine))
    losses = []
    loss = VolumeStage.loss
    monkeypatch.setattr(
        VolumeStage, "loss", lambda self, batch: losses.append(loss(self, batch)) or losses[-1]
    )
    monkeypatch.setattr(weights_module, "SHIPPED", finished.parent)
    path = train_estimator(
        TrainEstimatorConfig(
            data=dataset, out=tmp_path / "out", stages=("volume",), preset="paper", volume_steps=1,
            init=str(finished), base=finished.stem, validation=0.3, threads=1, workers=0,
            pose_noise=(1.0, 5.0), pose_loss=0.5,
        )
    )  # fmt: skip
    ((_, parts),) = losses
    assert {"coarse_pose", "pose", "coarse_distance", "fine_distance"} <= set(parts)
    header = read_header(path)
    assert header["networks"]["preset"] == "paper"
    assert header["trained"] == ["detector", "features", "volume"]
    assert header["training"]["pose_noise"] == {"degrees": 1.0, "millimeters": 5.0}
    assert header["training"]["pose_loss"] == 0.5 and header["training"]["cut_and_paste"] == 0
    assert header["base"]["name"] == finished.stem
    assert all(n.startswith(("volume.", "features.")) for n in load_file(path))
    assert path.stat().st_size < 0.2 * finished.stat().st_size
    assert pose_estimator.load("mid", path).object_names == ("brick", "crate")
    assert "of another preset, to be trained: volume" in capsys.readouterr().out


def test_pose_noise_and_cut_and_paste_options_reach_the_stage(
    dataset: Path, pack: CropPack, boxes, finished: Path, tmp_path: Path, monkeypatch
):
    quick(monkeypatch, boxes)
    stages, pasted = [], []
    paste = CropPaster.paste

    def listen(self, *args):
        pasted.append(self.config)
        return paste(self, *args)

    def keep(stage, loop, log) -> int:
        stages.append(stage)
        return stage.steps

    monkeypatch.setattr(CropPaster, "paste", listen)
    monkeypatch.setattr("two_view_pose.pose_estimator.training.trainer.run_stage", keep)
    config = TrainEstimatorConfig(
        data=dataset, out=tmp_path / "out", stages=("volume",), init=str(finished),
        validation=0.3, threads=1, workers=0,
        pose_noise=(2.0, 10.0), pose_loss=0.0, cut_and_paste=0.5,
    )  # fmt: skip
    train_estimator(config)
    (stage,) = stages
    assert stage.pose_noise == (2.0, 0.01) and stage.pose_weight == 0
    stage.train.draw_target(np.random.default_rng(0))
    assert pasted == [CutAndPasteConfig(0.5, 0.5)]
    stage.held_out.draw_target(np.random.default_rng(0))
    assert len(pasted) == 1


def test_encoders_are_trained_from_the_stage_that_is_asked_for(dataset, finished, tmp_path):
    for stages in (0, 2):
        config = TrainEstimatorConfig(
            data=dataset, out=tmp_path, init=str(finished), frozen_stages=stages
        )
        encoder = start_networks(config).features.encoder
        frozen = {n.split(".")[0] for n, p in encoder.named_parameters() if not p.requires_grad}
        assert ("stem" in frozen) == (stages > 0)
        trained = [all(p.requires_grad for p in stage.parameters()) for stage in encoder.stages]
        assert all(trained) if stages == 0 else not any(trained)  # depthwise filters are frozen


def test_a_larger_batch_of_the_decoders_shows_more_objects(pack, boxes):
    networks = PoseNetworks(boxes)
    training = TrainingSet(pack, boxes, networks.features.config)
    for scale, count in ((1, 1), (2, 2)):
        settings = TrainEstimatorConfig(Path(), Path(), batch_scale=scale).stage(
            "decoders", len(boxes)
        )
        assert settings.batch == 32 * scale
        stage = DecoderStage(
            networks, training, training, steps=1, batch=settings.batch, learning_rate=1.0, seed=0
        )
        objects = next(stage.batches(0))["object"]
        assert len(objects) == settings.batch and len(objects.unique()) == count


@pytest.mark.slow
def test_a_new_volume_keeps_the_other_parts(
    dataset: Path, pack: CropPack, boxes, tmp_path: Path, monkeypatch
):
    quick(monkeypatch, boxes)
    networks = PoseNetworks(boxes)
    networks.trained = frozenset({"detector", "features", "points", "cascade"})
    points = {n: t.clone() for n, t in networks.points.state_dict().items()}
    save_weights(networks, tmp_path / "first.safetensors", {})
    config = TrainEstimatorConfig(
        data=dataset, out=tmp_path / "out", stages=("volume",), volume_steps=1, validation=0.3,
        init=str(tmp_path / "first.safetensors"), threads=1, workers=0,
    )  # fmt: skip
    path = train_estimator(config)
    assert read_header(path)["trained"] == ["detector", "features", "volume", "cascade", "points"]
    kept = read_networks(path).points.state_dict()
    assert all(torch.allclose(kept[n], t, atol=1e-3) for n, t in points.items())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pose_noise": (-1.0, 0.0)}, "pose_noise must be finite and >= 0"),
        ({"pose_noise": (0.0, float("inf"))}, "pose_noise must be finite"),
        ({"pose_loss": -0.1}, "pose_loss must be >= 0, got -0.1"),
        ({"workers": -1}, "workers must be >= 0, got -1"),
        ({"max_minutes": float("inf")}, "max_minutes must be >= 0, got inf"),
        ({"lr_cycles": 0}, "lr_cycles must be >= 1, got 0"),
        ({"base": "a/b.safetensors"}, "base must be the name of shipped weights"),
        ({"batch_scale": 0}, "batch_scale must be >= 1, got 0"),
        ({"frozen_stages": -1}, "frozen_stages must be >= 0, got -1"),
        ({"cut_and_paste": 1.2}, "cut_and_paste must be 0 to 1, got 1.2"),
    ],
)
def test_invalid_options_are_rejected(tmp_path: Path, options, message):
    with pytest.raises(ValueError, match=message):
        TrainEstimatorConfig(data=tmp_path, out=tmp_path, **options)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA GPU")
def test_a_missing_gpu_is_reported_before_any_work(dataset: Path, tmp_path: Path):
    with pytest.raises(ValueError, match=r"device 'cuda:3': .* use cpu or auto"):
        train_estimator(TrainEstimatorConfig(data=dataset, out=tmp_path / "out", device="cuda:3"))
    assert not (tmp_path / "out").exists()


def test_a_missing_dataset_is_reported_first(tmp_path, monkeypatch):
    monkeypatch.delenv("BOP_PATH", raising=False)
    with pytest.raises(ValueError, match=r"no dataset .*nowhere: .* set BOP_PATH"):
        train_estimator(TrainEstimatorConfig(data=tmp_path / "nowhere", out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()
