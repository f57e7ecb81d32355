"""Where an environment's estimator runs."""

from __future__ import annotations

import gymnasium as gym
import pytest
import torch
from helpers.estimators import PickyEstimator
from two_view_pose import pose_estimator
from two_view_pose.assets import OBJECT_NAMES
from two_view_pose.envs import protocol

IDS = ("TwoViewPose-v0", "TwoViewPoseDiscrete-v0", "TwoViewPoseSequential-v0")


class LinemodEstimator(PickyEstimator):
    """Knows the thirteen objects."""

    object_names = OBJECT_NAMES


@pytest.fixture
def loaded(monkeypatch):
    """The calls of ``load``; every device is available."""
    calls = []

    def load(method="mid-pnp", weights="linemod", *, device="auto"):
        calls.append((method, str(weights), device))
        return LinemodEstimator()

    monkeypatch.setattr(pose_estimator, "load", load)
    monkeypatch.setattr(
        protocol, "resolve_device", lambda d: torch.device("cpu" if d == "auto" else d)
    )
    protocol.load_shipped.cache_clear()
    yield calls
    protocol.load_shipped.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize("env_id", IDS)
def test_an_estimator_is_loaded_onto_the_device(env_id, loaded):
    gym.make(env_id, device="cuda:1").close()
    gym.make(env_id, device="cuda:1", estimator="own.safetensors").close()
    assert loaded == [("mid-pnp", "linemod", "cuda:1"), ("mid-pnp", "own.safetensors", "cuda:1")]


def test_estimators_are_cached_per_device(loaded):
    on_cpu, automatic = (protocol.resolve_estimator("mid", d) for d in ("cpu", "auto"))
    assert on_cpu is automatic
    assert protocol.resolve_estimator("mid", "cuda") is not on_cpu
    assert [device for *_, device in loaded] == ["cpu", "cuda"]


def test_unavailable_device(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match="device 'cuda:7'"):
        gym.make("TwoViewPose-v0", device="cuda:7")


def test_device_with_an_own_estimator(make):
    with pytest.raises(ValueError, match="leave device at \"auto\", got 'cpu'"):
        make(estimator=LinemodEstimator(), device="cpu")
