"""Reinforcement learning over a bank: validation, resuming and pretrained extractors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.evaluation import evaluate_policy
from two_view_pose.agents.evaluation.evaluate_agent import evaluate_agents
from two_view_pose.agents.networks.candidates import candidate_features
from two_view_pose.agents.networks.checkpoint import read_agent
from two_view_pose.agents.networks.predictor import view_features
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.agents.training import train_agent as train
from two_view_pose.agents.training.config import EvaluateAgentConfig, TrainAgentConfig
from two_view_pose.agents.training.train_agent import CHECKPOINT, train_agent
from two_view_pose.core.errors import InputError
from two_view_pose.envs.view_banks.bank import ViewBank, write_bank

pytestmark = pytest.mark.slow

Make = Callable[..., ViewBank]

HYPERPARAMETERS = """
ppo:
  TwoViewPoseReplay-v0: &ppo
    n_envs: 4
    n_steps: 32
    batch_size: 64
    n_epochs: 2
    learning_rate: 1.0e-3
    policy_kwargs: &networks
      net_arch: [16]
      {extractor}
sac:
  TwoViewPoseReplay-v0:
    n_envs: 4
    buffer_size: 200
    learning_starts: 64
    batch_size: 32
    policy_kwargs: *networks
greedy:
  TwoViewPoseReplay-v0: {{epochs: 2, width: 4, features_dim: 16, networks: 1, dropout: 0.0}}
"""


COMBINED = "features_extractor_kwargs: {cnn_output_dim: 16}"  # SB3's own extractor
CANDIDATES = """features_extractor_class: CandidateExtractor
      features_extractor_kwargs: {width: 4, features_dim: 16}"""


@pytest.fixture
def config(make_bank: Make, tmp_path: Path) -> Callable[..., TrainAgentConfig]:
    write_bank(tmp_path / "bank.npz", make_bank(30))

    def make(extractor: str = COMBINED, out: str = "agent", **fields: Any) -> Any:
        path = tmp_path / f"{out}.yml"
        path.write_text(HYPERPARAMETERS.format(extractor=extractor))
        defaults: dict[str, Any] = {
            "bank": tmp_path / "bank.npz", "validation": 6, "evaluate_every": 128, "steps": 384,
            "hyperparameters": path, "progress": False, "checkpoint_every": 128,
        }  # fmt: skip
        if fields.get("algo") == "greedy":
            del defaults["steps"]
        return TrainAgentConfig(out=tmp_path / out, **{**defaults, **fields})

    return make


@pytest.mark.parametrize("algo", ["ppo", "sac"])
def test_train_and_evaluate_over_a_bank(
    algo: str, config: Callable[..., TrainAgentConfig], capsys: pytest.CaptureFixture[str]
) -> None:
    path = train_agent(config(algo=algo))
    header, _ = read_agent(path)
    assert header.env == "TwoViewPoseReplay-v0"
    records = evaluate_agents(
        EvaluateAgentConfig(
            policy=("random", "max-baseline", str(path), "oracle"),
            bank=config().bank,
            seeds=2,
            progress=False,
        )
    )
    rows = {
        (r["policy"], r["metric"]): r
        for r in records
        if r["object"] == "mean" and "visibility" not in r
    }
    assert rows[str(path), "add_s_recall"]["n"] == 30
    assert rows["oracle", "add_s_recall"]["value"] == 1.0
    assert rows["oracle", "gap_closed"]["value"] == pytest.approx(1.0)
    assert rows["max-baseline", "travel"]["value"] > rows["stay", "travel"]["value"] == 0.0


def test_resumed_run_ends_with_the_same_policy(
    config: Callable[..., TrainAgentConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = train_agent(config(out="whole"))
    save, saved = train.save_agent, []

    def save_then_die(*arguments: Any, **named: Any) -> None:
        save(*arguments, **named)
        saved.append(1)
        if len(saved) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(train, "save_agent", save_then_die)
    with pytest.raises(KeyboardInterrupt):
        train_agent(config(out="killed"))
    killed = train_agent(config(out="killed"))
    for name in (whole.name, CHECKPOINT):
        a, b = (read_agent(path.with_name(name))[1] for path in (whole, killed))
        assert a.keys() == b.keys()
        for key, value in a.items():
            assert torch.equal(value, b[key]), key


def validated_steps(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Collects the steps at which policies are validated."""
    steps: list[int] = []

    def spy(model: Any, *arguments: Any, **named: Any) -> Any:
        steps.append(model.num_timesteps)
        return evaluate_policy(model, *arguments, **named)

    monkeypatch.setattr("stable_baselines3.common.callbacks.evaluate_policy", spy)
    return steps


def test_short_run_writes_its_policy(
    config: Callable[..., TrainAgentConfig], capsys: pytest.CaptureFixture[str]
) -> None:
    path = train_agent(config(steps=100, evaluate_every=5000))
    assert read_agent(path)[0].steps == 128
    printed = capsys.readouterr().out
    assert "whole rollouts of 128 steps" in printed and "128 steps instead of 100" in printed
    path.unlink()
    assert train_agent(config(steps=100, evaluate_every=5000)).exists()
    assert "was missing: this is the last policy" in capsys.readouterr().out
    train_agent(config(out="other", steps=256))
    assert "whole rollouts" not in capsys.readouterr().out


def test_resumed_run_validates_at_the_same_steps(
    config: Callable[..., TrainAgentConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = validated_steps(monkeypatch)
    train_agent(config(steps=128, evaluate_every=160))
    train_agent(config(steps=384, evaluate_every=160))
    assert steps == [128, 160, 320, 384]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"algo": "sac", "steps": 64}, "steps must be > 64, since sac learns nothing before"),
        ({"algo": "greedy", "steps": 64}, "steps has no effect with the algorithm greedy"),
        ({"visibility_bank": Path("x.npz")}, "visibility_bank has no effect with the algorithm"),
    ],
)
def test_training_without_effect_is_rejected(
    fields: dict[str, Any], message: str, config: Callable[..., TrainAgentConfig]
) -> None:
    with pytest.raises(InputError, match=message):
        train_agent(config(**fields))


def test_pretrained_extractor(
    config: Callable[..., TrainAgentConfig],
) -> None:
    greedy = train_agent(config(algo="greedy", out="greedy"))
    path = train_agent(config(CANDIDATES, out="ppo", pretrained_extractor=greedy))
    _, weights = read_agent(path, prefix="policy/")
    _, before = read_agent(greedy, prefix="policy/networks.0.")
    for key, value in before.items():
        name = key.replace("policy/networks.0.", "policy/features_extractor.predictor.")
        assert torch.equal(weights[name], value), key
    env = gym.make("two_view_pose:TwoViewPoseReplay-v0", bank=str(config().bank))
    observation, _ = env.reset(seed=0)
    assert env.action_space.contains(make_policy(path, env).act(observation))
    with pytest.raises(ValueError, match="pretrained_extractor needs an agent of --algo greedy"):
        train_agent(config(out="other", pretrained_extractor=greedy))


def test_candidate_features_equal_view_features(make_bank: Make) -> None:
    bank = make_bank(20)
    expected = view_features(bank.T_cam_world, bank.center, bank.second_T_cam_world)
    found = candidate_features(
        torch.from_numpy(bank.first["camera"]), torch.from_numpy(bank.first["translation"])
    )
    np.testing.assert_allclose(found.numpy(), expected, atol=2e-4)


def test_bank_smaller_than_validation_is_rejected(
    config: Callable[..., TrainAgentConfig],
) -> None:
    with pytest.raises(ValueError, match="validation must be < 30"):
        train_agent(config(validation=30))
