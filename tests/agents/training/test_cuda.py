"""Agents on a CUDA GPU, if available."""

from __future__ import annotations

from collections.abc import Callable

import gymnasium as gym
import numpy as np
import pytest
import torch
from two_view_pose.agents.networks.algorithms import GreedyHyperparameters
from two_view_pose.agents.policies.greedy import GreedyPolicy
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.agents.policies.trained import channels_first
from two_view_pose.agents.training.config import TrainAgentConfig
from two_view_pose.agents.training.error_regression import predicted_best_slots, train_greedy_agent
from two_view_pose.agents.training.train_agent import train_agent
from two_view_pose.envs.view_banks.bank import ViewBank

pytestmark = [
    pytest.mark.cuda,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA GPU"),
]
REPLAY = "two_view_pose:TwoViewPoseReplay-v0"


def test_greedy_predictions_equal_cpu() -> None:
    env = gym.make("two_view_pose:TwoViewPose-v0", estimator=None, resolution=(120, 160))
    observation, _ = env.reset(seed=0)
    here, there = (make_policy("greedy", env, device) for device in ("cpu", "cuda"))
    assert isinstance(here, GreedyPolicy) and isinstance(there, GreedyPolicy)
    np.testing.assert_allclose(there.predict(observation), here.predict(observation), atol=5e-3)
    assert env.action_space.contains(there.act(observation))
    env.close()


def test_ppo_update(config: Callable[..., TrainAgentConfig]) -> None:
    path = train_agent(config(steps=32, device="cuda"))
    env = gym.make("helpers.toy_env:ToyView-v0")
    observation, _ = env.reset(seed=0)
    here, there = (make_policy(path, env, device) for device in ("cpu", "cuda"))
    np.testing.assert_allclose(there.act(observation), here.act(observation), atol=1e-2)


def test_greedy_training(make_bank: Callable[..., ViewBank]) -> None:
    bank = make_bank(60)
    space = channels_first(gym.make(REPLAY, bank=bank))
    hyperparameters = GreedyHyperparameters(epochs=40, networks=1, width=6, features_dim=32)
    before = torch.cuda.get_rng_state()
    agent = train_greedy_agent(bank, space, hyperparameters, 0, False, device=torch.device("cuda"))
    assert torch.equal(before, torch.cuda.get_rng_state())
    errors = bank.second_error[np.arange(60), predicted_best_slots(agent, bank)]
    assert agent.device.type == "cuda" and np.mean(errors < 0.1) > 0.8
