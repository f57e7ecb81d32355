"""Training learns, is deterministic under one seed, and resumes after a kill."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from two_view_pose.agents.networks.checkpoint import read_agent
from two_view_pose.agents.policies.trained import load_policy
from two_view_pose.agents.training import train_agent as train
from two_view_pose.agents.training.config import TrainAgentConfig
from two_view_pose.agents.training.train_agent import (
    CHECKPOINT,
    LOGS,
    POLICY,
    save_agent,
    train_agent,
)

pytestmark = pytest.mark.slow

Make = Callable[..., TrainAgentConfig]


def weights(folder: Path, name: str = CHECKPOINT) -> dict[str, torch.Tensor]:
    return read_agent(folder / name)[1]


def assert_equal(left: dict[str, torch.Tensor], right: dict[str, torch.Tensor]) -> None:
    assert left.keys() == right.keys()
    for key, value in left.items():
        assert torch.equal(value, right[key]), key


def first_weight(folder: Path) -> torch.Tensor:
    return next(value for key, value in weights(folder, POLICY).items() if key.endswith("weight"))


def mean_reward(act: Callable[[dict[str, np.ndarray]], object], episodes: int = 200) -> float:
    env = gym.make("helpers.toy_env:ToyView-v0")
    rewards = []
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        rewards.append(env.step(act(observation))[1])
    return float(np.mean(rewards))


def test_ppo_learns_the_toy_problem(config: Make, hyperparameters: Path) -> None:
    hyperparameters.write_text("""
ppo:
  ToyView-v0:
    n_steps: 128
    batch_size: 64
    n_epochs: 8
    learning_rate: lin_3.0e-3
    policy_kwargs:
      net_arch: [32]
      log_std_init: -0.7
      features_extractor_kwargs: {cnn_output_dim: 8}
""")
    path = train_agent(config(steps=2048, checkpoint_every=1024))
    trained = mean_reward(load_policy(path, gym.make("helpers.toy_env:ToyView-v0")).act)
    rng = np.random.default_rng(0)
    untrained = mean_reward(lambda _: rng.uniform(-1, 1, 3).astype(np.float32))
    center = mean_reward(lambda _: np.zeros(3, np.float32))  # best constant action
    assert untrained < center < -0.45
    assert trained > -0.2


@pytest.mark.parametrize("algo", ["ppo", "sac", "dqn"])
def test_training_is_deterministic_and_resumable(
    algo: str, config: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, again = config(algo, "whole", steps=96), config(algo, "again", steps=96)
    train_agent(whole)

    def interrupt(*arguments: object, **named: object) -> None:
        save_agent(*arguments, **named)
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "save_agent", interrupt)
    with pytest.raises(KeyboardInterrupt):
        train_agent(again)
    assert read_agent(again.out / CHECKPOINT)[0].steps == 32
    monkeypatch.undo()
    train_agent(again)

    assert_equal(weights(whole.out), weights(again.out))
    assert (whole.out / POLICY).read_bytes() == (again.out / POLICY).read_bytes()
    other = config(algo, "other", steps=96, seed=1)
    train_agent(other)
    assert not torch.equal(first_weight(whole.out), first_weight(other.out))


def test_killed_process_resumes_from_checkpoint(config: Make) -> None:
    whole, killed = config(out="whole", steps=1280), config(out="killed", steps=1280)
    train_agent(whole)
    script = f"""
from pathlib import PosixPath
import torch
from two_view_pose.agents.training.config import TrainAgentConfig
from two_view_pose.agents.training.train_agent import train_agent
torch.set_num_threads(1)
train_agent({killed!r})
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen([sys.executable, "-c", script], env=environment)
    deadline = time.monotonic() + 300
    while not (killed.out / CHECKPOINT).exists():
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert read_agent(killed.out / CHECKPOINT)[0].steps < 1280

    train_agent(killed)
    assert_equal(weights(whole.out), weights(killed.out))
    assert list((killed.out / LOGS).glob("ppo_1/events.*"))


def test_parallel_environments(config: Make) -> None:
    path = train_agent(config(steps=128, n_envs=2, checkpoint_every=64))
    assert read_agent(path)[0].n_envs == 2


def test_finished_run_is_unchanged(config: Make, capsys: pytest.CaptureFixture[str]) -> None:
    path = train_agent(config(steps=64))
    before = path.read_bytes()
    assert train_agent(config(steps=64)) == path
    assert path.read_bytes() == before
    printed = capsys.readouterr().out
    assert f"evaluate-agent --policy random fixed max-baseline {path}" in printed


def test_results_file(config: Make, tmp_path: Path) -> None:
    train_agent(config(steps=64, json=tmp_path / "results.json", seed=3))
    document = json.loads((tmp_path / "results.json").read_text())
    assert document["seed"] == 3
    values = {record["metric"]: record["value"] for record in document["records"]}
    assert values["steps"] == 64
    assert -1.0 < values["mean_reward"] < 0.0
    assert values["steps_per_second"] > 0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"seed": 5}, "seed is 0, this one's is 5"),
        ({"env_kwargs": {"gain": 2.0}}, "env_kwargs"),
        ({"checkpoint_every": 64}, "checkpoint_every"),
    ],
)
def test_checkpoint_of_another_run_is_rejected(
    fields: dict[str, object], message: str, config: Make
) -> None:
    train_agent(config(steps=32))
    with pytest.raises(ValueError, match=message):
        train_agent(config(steps=64, **fields))
    train_agent(config(steps=32, resume=False, **fields))


def test_training_resumes_on_another_device(config: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """The device is not part of the header."""
    devices, make = [], gym.make

    def spy(env_id: str, **arguments: Any) -> gym.Env:
        devices.append(arguments.get("device", "auto"))
        return make(env_id, **arguments)

    monkeypatch.setattr(gym, "make", spy)
    train_agent(config(steps=32, estimator="mid", device="cpu"))
    path = train_agent(config(steps=64, estimator="mid", device="auto"))
    assert devices == ["cpu", "auto"]
    header, _ = read_agent(path)
    assert header.steps == 64 and header.env_kwargs == {"scene": "linemod", "estimator": "mid"}


def test_invalid_arguments(config: Make) -> None:
    with pytest.raises(ValueError, match="steps must be >= 1, got 0"):
        config(steps=0)
    with pytest.raises(ValueError, match="seed must be >= 0"):
        config(seed=-1)
    with pytest.raises(ValueError, match="plain data"):
        train_agent(config(env_kwargs={"gain": np.float32}))
    with pytest.raises(ValueError, match="no entry sac: ToyViewDiscrete-v0"):
        train_agent(config("sac", env="helpers.toy_env:ToyViewDiscrete-v0"))
