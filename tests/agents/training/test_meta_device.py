"""Tensors are created on the device of the agents' networks; checked without a GPU.

With meta as the default device, combining a tensor created without a device with a CPU tensor
raises. With the networks on meta, so does a tensor left on the CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import spaces
from two_view_pose.agents.networks.algorithms import GreedyHyperparameters
from two_view_pose.agents.networks.candidates import CandidateExtractor
from two_view_pose.agents.policies.greedy import GreedyAgent, GreedyPolicy, to_tensors
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.agents.policies.trained import channels_first
from two_view_pose.agents.training.config import TrainAgentConfig
from two_view_pose.agents.training.error_regression import predicted_best_slots, train_greedy_agent
from two_view_pose.agents.training.train_agent import train_agent
from two_view_pose.agents.training.training_state import state_tensors
from two_view_pose.envs.view_banks.bank import ViewBank

REPLAY = "two_view_pose:TwoViewPoseReplay-v0"
QUICK = GreedyHyperparameters(epochs=1, networks=2, width=6, features_dim=32, batch_size=5)
META = torch.device("meta")


@contextmanager
def meta_by_default() -> Iterator[None]:
    torch.set_default_device("meta")
    try:
        yield
    finally:
        torch.set_default_device(None)


@pytest.fixture
def bank(make_bank: Callable[..., ViewBank]) -> ViewBank:
    return make_bank(10)


@pytest.fixture
def space(bank: ViewBank) -> spaces.Dict:
    return channels_first(gym.make(REPLAY, bank=bank))


def test_meta_default_device_raises() -> None:
    with meta_by_default(), pytest.raises(RuntimeError, match="meta"):
        torch.from_numpy(np.ones(2)) + torch.zeros(2)


def test_candidate_extractor(bank: ViewBank, space: spaces.Dict) -> None:
    extractor = CandidateExtractor(space).eval()
    observations = to_tensors(bank.first, torch.device("cpu"))
    with torch.inference_mode():
        expected = extractor(observations)
        with meta_by_default():
            assert torch.equal(extractor(observations), expected)
        on_meta = {key: value.to(META) for key, value in observations.items()}
        assert extractor.to(META)(on_meta).shape == expected.shape


def test_greedy_policy_with_meta_default(bank: ViewBank) -> None:
    env = gym.make(REPLAY, bank=bank)
    agent = GreedyAgent(channels_first(env), QUICK).eval()
    observation, _ = env.reset(seed=0)
    header = _header(env)
    expected = GreedyPolicy(agent, header, env).predict(observation)
    slots = predicted_best_slots(agent, bank)
    with meta_by_default():
        policy = GreedyPolicy(agent, header, env)
        np.testing.assert_array_equal(policy.predict(observation), expected)
        assert env.action_space.contains(policy.act(observation))
        assert 0 < agent.confidence(observation, observation) < 1
        np.testing.assert_array_equal(predicted_best_slots(agent, bank), slots)


def test_greedy_moves_inputs_to_the_device(bank: ViewBank) -> None:
    env = gym.make(REPLAY, bank=bank)
    agent = GreedyAgent(channels_first(env), QUICK).eval().to(META)
    policy = GreedyPolicy(agent, _header(env), env)
    observation, _ = env.reset(seed=0)
    # Up to the copy to the CPU, which meta tensors do not support.
    for call in (
        lambda: policy.predict(observation),
        lambda: predicted_best_slots(agent, bank),
    ):
        with pytest.raises(NotImplementedError, match="Cannot copy out of meta tensor"):
            call()
    with pytest.raises(RuntimeError, match=r"item\(\) cannot be called on meta tensors"):
        agent.confidence(observation, observation)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["greedy", "ppo"])
def test_shipped_agents_with_meta_default(name: str) -> None:
    env = gym.make("two_view_pose:TwoViewPoseDiscrete-v0", estimator=None, resolution=(120, 160))
    policy = make_policy(name, env, "cpu")
    observation, _ = env.reset(seed=0)
    policy.reset(np.random.default_rng(0))
    expected = policy.act(observation)
    with meta_by_default():
        policy.reset(np.random.default_rng(0))
        assert policy.act(observation) == expected
    env.close()


def test_supervised_training(bank: ViewBank, space: spaces.Dict) -> None:
    expected = train_greedy_agent(bank, space, QUICK, 3, False, bank).state_dict()
    with meta_by_default():
        found = train_greedy_agent(bank, space, QUICK, 3, False, bank).state_dict()
    for key, value in expected.items():
        assert torch.equal(value, found[key]), key


@pytest.mark.slow
def test_supervised_training_on_meta(bank: ViewBank, space: spaces.Dict) -> None:
    agent = train_greedy_agent(bank, space, QUICK, 3, False, bank, META)
    assert {parameter.device.type for parameter in agent.parameters()} == {"meta"}


def test_replay_buffer_is_saved_from_cpu(
    config: Callable[..., TrainAgentConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    from two_view_pose.agents.training import train_agent as train

    saved = []

    def save(model: Any, *_: object, **__: object) -> None:
        with meta_by_default():
            saved.append(state_tensors(model))

    monkeypatch.setattr(train, "save_agent", save)
    train_agent(config("dqn", steps=20, device="cpu"))
    assert saved and {value.device.type for value in saved[-1].values()} == {"cpu"}
    assert int(saved[-1]["replay/position"]) == 20


def _header(env: gym.Env) -> Any:
    from two_view_pose.agents.networks.checkpoint import AgentHeader, describe_space

    return AgentHeader(
        algo="greedy", env=REPLAY, env_kwargs={}, hyperparameters=vars(QUICK), n_envs=1, seed=0,
        checkpoint_every=1, steps=0, observation_space=describe_space(env.observation_space),
        action_space=describe_space(env.action_space),
    )  # fmt: skip
