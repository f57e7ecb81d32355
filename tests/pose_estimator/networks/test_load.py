"""The arguments of ``load``."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from two_view_pose import pose_estimator
from two_view_pose.core import device as device_module
from two_view_pose.pose_estimator.fusion import single as single_view
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.volume import PRESETS
from two_view_pose.pose_estimator.networks.weights import load_networks, save_weights


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory, networks: PoseNetworks) -> Path:
    path = tmp_path_factory.mktemp("weights") / "boxes.safetensors"
    save_weights(networks, path, {"what": "untrained"})
    return path


@pytest.mark.parametrize("method", ["single", "late", "mid"])
@pytest.mark.parametrize("solver", ["soft", "kabsch", "hard"])
def test_load_sets_the_solver(saved, method, solver):
    estimator = pose_estimator.load(method, saved, preset="fast", solver=solver)
    assert estimator.solver == solver
    assert type(estimator).__name__.lower().startswith(method)


def test_the_preset_sets_the_solver_and_the_method_the_refinement(saved):
    assert PRESETS["paper"].solver == "soft-mean"
    found = [pose_estimator.load(method, saved) for method in ("mid", "mid-pnp")]
    assert [(e.solver, e.refinement) for e in found] == [("soft", "none"), ("soft", "votes")]
    assert pose_estimator.load("mid-pnp", saved, refine="none").refinement == "none"


def test_another_preset_names_the_training_command(saved):
    with pytest.raises(ValueError, match=r"'fast', not 'paper'.*train-estimator --preset paper"):
        pose_estimator.load("mid", saved, preset="paper")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"method": "latest"},
            "unknown method 'latest'; there are single, early, late, mid, pnp, mid-pnp, rgbd",
        ),
        ({"preset": "quick"}, "unknown preset 'quick'; there are fast, features, paper"),
        ({"solver": "best"}, "unknown solver 'best'; there are soft, soft-mean, kabsch, hard"),
        ({"device": "tpu"}, "device must be auto, cpu, cuda, cuda:N or mps, got 'tpu'"),
        ({"threads": -1}, "threads must be >= 0, got -1"),
    ],
)
def test_invalid_arguments_raise(saved, wrong, message):
    with pytest.raises(ValueError, match=message):
        pose_estimator.load(**({"weights": saved} | wrong))


def test_networks_are_cached_for_each_device(saved, monkeypatch):
    here = pose_estimator.load("single", saved, device="cpu").networks
    monkeypatch.setattr(device_module, "resolve_device", lambda device: torch.device(device))
    there = pose_estimator.load("single", saved, device="meta").networks
    assert {value.device.type for value in there.state_dict().values()} == {"meta"}
    assert {value.device.type for value in here.state_dict().values()} == {"cpu"}
    assert there is load_networks(saved, torch.device("meta")) and here is load_networks(saved)


def test_threads_are_passed_on(saved, monkeypatch):
    monkeypatch.setattr(single_view, "SingleViewEstimator", lambda networks, *options: options)
    found = pose_estimator.load("single", saved, solver="hard", threads=3, refine="votes")
    assert found == ("hard", 3, "votes")


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA GPU")
def test_auto_takes_the_gpu(saved):
    assert pose_estimator.load("mid", saved).networks.device.type == "cuda"
