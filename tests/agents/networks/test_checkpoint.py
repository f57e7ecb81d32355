"""Agent files: round trip, corrupted files, and no code execution."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3 as sb3
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from two_view_pose.agents.networks.checkpoint import read_agent, subset, write_agent
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.agents.training.config import TrainAgentConfig
from two_view_pose.agents.training.train_agent import CHECKPOINT, train_agent

Make = Callable[..., TrainAgentConfig]


@pytest.fixture
def agent(config: Make) -> Path:
    return train_agent(config(steps=32))


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["ppo", "sac", "dqn"])
def test_loaded_policy_equals_trained_policy(
    algo: str, config: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    models = []
    learn = sb3.common.base_class.BaseAlgorithm._setup_learn
    monkeypatch.setattr(
        sb3.common.base_class.BaseAlgorithm,
        "_setup_learn",
        lambda self, *args, **kwargs: models.append(self) or learn(self, *args, **kwargs),
    )
    path = train_agent(config(algo, steps=64))
    env = gym.make(
        "helpers.toy_env:ToyViewDiscrete-v0" if algo == "dqn" else "helpers.toy_env:ToyView-v0"
    )
    torch.manual_seed(0)
    before = torch.get_rng_state()
    policies = [make_policy(path, env), make_policy(path.with_name(CHECKPOINT), env)]
    assert torch.equal(before, torch.get_rng_state())
    for seed in range(20):
        observation, _ = env.reset(seed=seed)
        expected, _ = models[0].predict(observation, deterministic=True)
        half, full = (policy.act(observation) for policy in policies)
        assert env.action_space.contains(half) and env.action_space.contains(full)
        assert np.array_equal(full, expected)
        assert np.allclose(half, expected, atol=2e-3)


def test_shared_tensors_are_stored_once(agent: Path) -> None:
    header, tensors = read_agent(agent)
    extractors = ("features_extractor", "pi_features_extractor", "vf_features_extractor")
    sizes = [len(subset(tensors, f"policy/{name}.")) for name in extractors]
    assert sizes[0] > 0 and sizes == [sizes[0]] * 3
    assert len(header.aliases) == 2 * sizes[0]
    with safe_open(agent, framework="pt") as file:
        assert len(file.keys()) == len(tensors) - len(header.aliases)
    assert read_agent(agent, prefix="policy/vf_")[1].keys() <= header.aliases.keys()
    for wrong in ({"a": "nowhere"}, {"a": 3}, ["a"]):
        content = {**asdict(header), "aliases": wrong}
        save_file(tensors, agent, {"header": json.dumps(content)})
        with pytest.raises(ValueError, match=r"corrupted header|not a complete safetensors file"):
            read_agent(agent)


def test_policy_file_is_half_precision(agent: Path) -> None:
    _, tensors = read_agent(agent)
    weights = [t for t in tensors.values() if t.is_floating_point()]
    assert weights and all(t.dtype == torch.float16 for t in weights)
    full = read_agent(agent.with_name(CHECKPOINT), prefix="policy/")[1]
    assert full.keys() == tensors.keys()
    for key, tensor in full.items():
        assert torch.equal(tensor.to(tensors[key].dtype), tensors[key]), key


class Bomb:
    """Writes a file when it is unpickled."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return eval, (f"open({str(self.target)!r}, 'w').close()",)


def test_loading_executes_no_code(tmp_path: Path, agent: Path, config: Make) -> None:
    crater = tmp_path / "crater"
    env = gym.make("helpers.toy_env:ToyView-v0")
    bombs = {"a.pkl": pickle.dumps(Bomb(crater)), "old.pkl": pickle.dumps(Bomb(crater), protocol=0)}
    for name, content in bombs.items():
        (tmp_path / name).write_bytes(content)
    torch.save(Bomb(crater), tmp_path / "torch.safetensors")
    sb3.PPO("MultiInputPolicy", env, n_steps=8, batch_size=8).save(tmp_path / "sb3.zip")
    for name in (*bombs, "torch.safetensors", "sb3.zip"):
        with pytest.raises(ValueError, match=r"(not loaded|not a complete safetensors file)"):
            make_policy(tmp_path / name, env)
        folder = tmp_path / f"resume-{name}"
        folder.mkdir()
        (folder / CHECKPOINT).write_bytes((tmp_path / name).read_bytes())
        with pytest.raises(ValueError, match=r"(not loaded|not a complete safetensors file)"):
            train_agent(config(out=folder.name, steps=64))
    header, tensors = read_agent(agent)
    for kwargs in (
        {"features_extractor_class": "os.system"},
        {"activation_fn": "eval"},
        "dict(net_arch=__import__('os'))",
    ):
        hostile = replace(header, hyperparameters={"policy_kwargs": kwargs})
        write_agent(agent, hostile, tensors)
        with pytest.raises(
            ValueError, match=r"policy_kwargs|activation_fn|features_extractor_class"
        ):
            make_policy(agent, env)
    assert not crater.exists()


def test_corrupted_files_are_rejected(tmp_path: Path, agent: Path) -> None:
    env = gym.make("helpers.toy_env:ToyView-v0")
    content = agent.read_bytes()
    header, tensors = read_agent(agent)
    bad = tmp_path / "bad.safetensors"

    def rejected(match: str) -> None:
        with pytest.raises(ValueError, match=match):
            make_policy(bad, env)

    for corrupted in (b"", b"\0" * 100, content[:-100], content[:50], b"\xff" * 8 + content[8:]):
        bad.write_bytes(corrupted)
        rejected("not a complete safetensors file")
    save_file(tensors, bad)
    rejected("has no header")
    save_file(tensors, bad, {"header": "{"})
    rejected("corrupted header")
    save_file(tensors, bad, {"header": json.dumps({"format": "another 7"})})
    rejected("must have the format")
    save_file(tensors, bad, {"header": json.dumps({"format": header.format, "algo": "ppo"})})
    rejected("corrupted header: .* missing")
    write_agent(bad, replace(header, algo="a2c"), tensors)
    rejected("algo must be one of ppo, sac, dqn, greedy, got 'a2c'")
    write_agent(bad, replace(header, hyperparameters={"color": 1}), tensors)
    rejected("unknown hyper-parameters of ppo: color")
    name = next(iter(tensors))
    write_agent(bad, header, {key: value for key, value in tensors.items() if key != name})
    rejected("does not fit: missing")
    write_agent(bad, header, {**tensors, name: torch.zeros(1)})
    rejected("must be of shape")
    write_agent(bad, header, {**tensors, name: torch.full_like(tensors[name], torch.nan)})
    rejected("NaN")
    for change in (
        {"hyperparameters": {"policy_kwargs": {"net_arch": ["8"]}}},
        {"hyperparameters": {"policy_kwargs": {"net_arch": [10**9]}}},  # would take terabytes
        {"hyperparameters": {"policy_kwargs": {"color": 1}}},
        {"algo": "greedy", "hyperparameters": {"width": "4"}},
        {"observation_space": 3},
        {"algo": "greedy", "hyperparameters": {}, "observation_space": 3},
        {"steps": -1},
        {"counters": {"num_timesteps": "8"}},
    ):
        write_agent(bad, replace(header, **change), tensors)
        rejected(r"agent file .*bad\.safetensors")
    save_file(tensors, bad, {"header": '{"format": ' + "9" * 5000})
    rejected(r"bad\.safetensors has a corrupted header")


def test_other_spaces_are_rejected(agent: Path) -> None:
    with pytest.raises(
        ValueError, match=r"trained on helpers.toy_env:ToyView-v0 with the action space"
    ):
        make_policy(agent, gym.make("helpers.toy_env:ToyViewDiscrete-v0"))


def test_corrupted_checkpoint_is_rejected(config: Make) -> None:
    run = config("dqn", steps=32)
    train_agent(run)
    path = run.out / CHECKPOINT
    header, tensors = read_agent(path)
    longer = replace(run, steps=64)
    for key, value, message in (
        ("replay/position", torch.tensor(-3), "replay buffer of 40 has 32 entries at position -3"),
        (
            "replay/rewards",
            torch.zeros(32, 9),
            "does not fit: rewards must be of shape",
        ),
        ("optimizer/policy.optimizer/0/exp_avg", torch.zeros(3), "wrong shape"),
    ):
        write_agent(path, header, {**tensors, key: value})
        with pytest.raises(ValueError, match=message):
            train_agent(longer)
    for counters, message in (
        ({}, "counters lack"),
        (header.counters | {"num_timesteps": 1.5}, "num_timesteps must be an integer"),
    ):
        write_agent(path, replace(header, counters=counters), tensors)
        with pytest.raises(ValueError, match=rf"checkpoint\.safetensors .*{message}"):
            train_agent(longer)


def test_failed_write_keeps_the_old_file(agent: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = agent.read_bytes()
    header, tensors = read_agent(agent)

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr("two_view_pose.core.results.os.fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        write_agent(agent, replace(header, steps=7), tensors)
    assert agent.read_bytes() == content
    assert [path.name for path in agent.parent.glob(".*")] == []
