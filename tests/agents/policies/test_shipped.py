"""Shipped agents act in their environments."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from two_view_pose.agents.policies.registry import make_policy

RENDERED = {"estimator": None, "scene": "linemod", "resolution": (120, 160)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "env_id"),
    [
        ("greedy", "TwoViewPose-v0"),
        ("greedy", "TwoViewPoseDiscrete-v0"),
        ("greedy", "TwoViewPoseSequential-v0"),
        ("ppo", "TwoViewPoseDiscrete-v0"),
    ],
)
def test_shipped_agents_act_deterministically(name: str, env_id: str) -> None:
    env = gym.make(f"two_view_pose:{env_id}", **RENDERED)
    policy = make_policy(name, env)
    observation, _ = env.reset(seed=0)
    policy.reset(np.random.default_rng(0))
    action = policy.act(observation)
    assert env.action_space.contains(action)
    policy.reset(np.random.default_rng(1))
    again = policy.act(observation)
    assert np.array_equal(action, again)
    env.close()
