"""Hyper-parameter files are validated and never executed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import pytest
import stable_baselines3 as sb3
import yaml
from two_view_pose.agents.networks.algorithms import ALGORITHMS, GREEDY, GreedyHyperparameters
from two_view_pose.agents.networks.candidates import CandidateExtractor
from two_view_pose.agents.training import zoo
from two_view_pose.agents.training.hyperparameters import (
    SHIPPED,
    algorithm_kwargs,
    load_hyperparameters,
)
from two_view_pose.core.errors import InputError
from two_view_pose.envs.view_banks.bank import ViewBank

ENTRIES = [
    (algo, env_id)
    for algo, table in yaml.safe_load(SHIPPED.read_text()).items()
    for env_id in table
]


@pytest.mark.parametrize(("algo", "env_id"), [e for e in ENTRIES if "Replay" in e[1]])
def test_shipped_hyperparameters_over_a_bank(
    algo: str, env_id: str, make_bank: Callable[..., ViewBank]
) -> None:
    entry = load_hyperparameters(algo, env_id)
    if algo == GREEDY:
        GreedyHyperparameters(**entry)
        return
    action = "box" if algo == "sac" else "discrete"
    env = gym.make(f"two_view_pose:{env_id}", bank=make_bank(4), action=action)
    kwargs = algorithm_kwargs(entry)
    model = ALGORITHMS[algo]("MultiInputPolicy", env, device="cpu", **{**kwargs, "batch_size": 64})
    extractors = [m for m in model.policy.modules() if isinstance(m, CandidateExtractor)]
    assert extractors
    assert not any(p.requires_grad for e in extractors for p in e.predictor.parameters())


@pytest.mark.parametrize(("algo", "env_id"), [e for e in ENTRIES if "Replay" not in e[1]])
def test_shipped_hyperparameters(algo: str, env_id: str) -> None:
    entry = load_hyperparameters(algo, env_id)
    toy = (
        "helpers.toy_env:ToyViewDiscrete-v0"
        if "Discrete" in env_id
        else "helpers.toy_env:ToyView-v0"
    )
    kwargs = algorithm_kwargs(entry)
    model = ALGORITHMS[algo]("MultiInputPolicy", gym.make(toy), device="cpu", **kwargs)
    assert model.lr_schedule(1.0) == pytest.approx(3e-4)
    assert model.lr_schedule(0.0) == pytest.approx(0.0 if algo == "ppo" else 3e-4)


@pytest.mark.parametrize("env_id", [env_id for algo, env_id in ENTRIES if algo == "ppo"])
def test_rl_zoo3_conf_file(env_id: str, make_bank: Callable[..., ViewBank]) -> None:
    entry = dict(zoo.hyperparams[env_id])
    toy = (
        "helpers.toy_env:ToyViewDiscrete-v0"
        if "Discrete" in env_id
        else "helpers.toy_env:ToyView-v0"
    )
    replay = "Replay" in env_id
    env = gym.make(f"two_view_pose:{env_id}", bank=make_bank(4)) if replay else gym.make(toy)
    assert entry.pop("n_timesteps") > 0 and entry.pop("n_envs") > 0
    # rl-zoo3 itself converts text such as lin_3.0e-4.
    assert entry.pop("learning_rate").startswith("lin_")
    entry["batch_size"] = entry["n_steps"]
    model = sb3.PPO(entry.pop("policy"), env, device="cpu", **entry)
    assert isinstance(model.policy.features_extractor, CandidateExtractor) == replay


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ppo: [", "cannot be read"),
        ("ppo: !!python/object/apply:os.system ['touch crater']", "cannot be read"),
        ("ppo: " + "9" * 5000, "cannot be read"),
        ("[" * 10_000, "cannot be read"),
        ("[]", "no entry ppo: ToyView-v0"),
        ("sac: {ToyView-v0: {}}", "no entry ppo: ToyView-v0"),
        ("ppo: {ToyView-v0: {color: red}}", "unknown hyper-parameters of ppo: color"),
        ("ppo: {ToyView-v0: {policy: MlpPolicy}}", "policy must be MultiInputPolicy"),
        ("ppo: {ToyView-v0: {learning_rate: lin_fast}}", "must be lin_<number>, got 'lin_fast'"),
        ("ppo: {ToyView-v0: {policy_kwargs: 'dict(net_arch=[])'}}", "must be a mapping"),
        ("ppo: {ToyView-v0: {policy_kwargs: {optimizer_class: x}}}", "unknown policy_kwargs"),
        ("ppo: {ToyView-v0: {policy_kwargs: {net_arch: &a [*a]}}}", "nested more than"),
        ("ppo: {ToyView-v0: {'': 1}}", "unknown hyper-parameters of ppo"),
    ],
)
def test_invalid_file_is_rejected(
    text: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.yml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        algorithm_kwargs(load_hyperparameters("ppo", "ToyView-v0", path))
    assert str(path) in str(caught.value)
    assert not (tmp_path / "crater").exists()


@pytest.mark.parametrize(
    ("name", "value"),
    [("width", "4"), ("networks", 0), ("features_dim", 10**9), ("dropout", 2), ("sure", None)],
)
def test_greedy_numbers_are_checked(tmp_path: Path, name: str, value: object) -> None:
    path = tmp_path / "mine.yml"
    path.write_text(yaml.safe_dump({"greedy": {"ToyView-v0": {name: value}}}))
    with pytest.raises(InputError, match=rf"mine\.yml.*{name} must be"):
        load_hyperparameters("greedy", "ToyView-v0", path)
