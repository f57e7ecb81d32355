"""Baseline policies, compared with the geometry of their views."""

from __future__ import annotations

from itertools import product

import gymnasium as gym
import numpy as np
import pytest
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.envs.simulation.carrier import camera_center

RULES = ("random", "fixed", "above", "max-baseline")
ENVS = ("helpers.toy_env:ToySphere-v0", "helpers.toy_env:ToySphereDiscrete-v0")


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "name"), [*product(ENVS, RULES)])
def test_actions_are_valid(env_id: str, name: str) -> None:
    env = gym.make(env_id)
    policy = make_policy(name, env)
    for seed in range(30):
        observation, _ = env.reset(seed=seed)
        policy.reset(np.random.default_rng(seed))
        action = policy.act(observation)
        assert env.action_space.contains(action)
        env.step(action)


def test_random_is_uniform_and_seeded() -> None:
    for env_id, expected in zip(ENVS, (0.0, 11.5), strict=True):
        env = gym.make(env_id)
        policy = make_policy("random", env)
        observation, _ = env.reset(seed=0)
        policy.reset(np.random.default_rng(7))
        first = np.array([policy.act(observation) for _ in range(2000)])
        policy.reset(np.random.default_rng(7))
        assert np.array_equal(first, [policy.act(observation) for _ in range(2000)])
        middle, half = first.mean(axis=0), np.ptp(first, axis=0) / 2
        assert np.all(np.abs(middle - expected) < 0.05 * half)
        assert np.all(half > 0.99) if env_id == ENVS[0] else set(first) == set(range(24))


def test_fixed_has_30_degrees_azimuth_offset() -> None:
    env = gym.make("helpers.toy_env:ToySphere-v0")
    policy = make_policy("fixed", env)
    for seed in range(30):
        observation, _ = env.reset(seed=seed)
        sphere = env.unwrapped
        place = sphere.reference_position
        x, y, z = camera_center(sphere.camera_pose(policy.act(observation))) - sphere.sphere_center
        azimuth = np.angle(np.exp(1j * (np.arctan2(y, x) - place.azimuth)))
        assert np.rad2deg(azimuth) == pytest.approx(30.0, abs=1e-3)
        assert np.hypot(x, y) == pytest.approx(place.distance * np.cos(place.elevation), abs=1e-5)
        assert z == pytest.approx(place.distance * np.sin(place.elevation), abs=1e-5)


def test_fixed_takes_the_nearest_candidate() -> None:
    box, discrete = gym.make(ENVS[0]), gym.make(ENVS[1])
    for seed in range(30):
        observation, _ = box.reset(seed=seed)
        discrete.reset(seed=seed)
        target = camera_center(
            box.unwrapped.camera_pose(make_policy("fixed", box).act(observation))
        )
        places = np.array([camera_center(discrete.unwrapped.camera_pose(i)) for i in range(24)])
        # All on one sphere: the nearest in distance is the nearest in angle.
        distances = np.linalg.norm(places - target, axis=1)
        chosen = make_policy("fixed", discrete).act(observation)
        assert distances[chosen] < distances.min() + 1e-6


def test_above_has_70_degrees_elevation() -> None:
    for env_id in ENVS:
        env = gym.make(env_id)
        policy = make_policy("above", env)
        for seed in range(10):
            observation, _ = env.reset(seed=seed)
            sphere = env.unwrapped
            offset = camera_center(sphere.camera_pose(policy.act(observation)))
            offset -= sphere.sphere_center
            elevation = np.rad2deg(np.arcsin(offset[2] / np.linalg.norm(offset)))
            assert elevation == pytest.approx(70.0, abs=1e-3)


def test_stay_takes_no_second_view() -> None:
    env = gym.make(ENVS[0])
    assert make_policy("stay", env).act(env.reset(seed=0)[0]) is None


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ENVS)
def test_max_baseline_is_the_farthest_view(env_id: str) -> None:
    env = gym.make(env_id)
    policy = make_policy("max-baseline", env)
    grid = np.linspace(-1.0, 1.0, 21)
    if env_id == ENVS[0]:
        actions: list[object] = [np.array((*p, 0.3), np.float32) for p in product(grid, grid)]
    else:
        actions = list(range(24))
    for seed in range(10):
        observation, _ = env.reset(seed=seed)
        sphere = env.unwrapped
        farthest = max(sphere.angle(sphere.camera_pose(action)) for action in actions)
        chosen = sphere.angle(sphere.camera_pose(policy.act(observation)))
        assert chosen >= farthest - 1e-6


def test_unknown_policy_and_unsupported_environment() -> None:
    env = gym.make("helpers.toy_env:ToySphere-v0")
    with pytest.raises(
        ValueError, match=r"policy must be one of stay, random, fixed, above, .* or a file"
    ):
        make_policy("nothing", env)
    with pytest.raises(ValueError, match="needs an environment with a view sphere"):
        make_policy("fixed", gym.make("helpers.toy_env:ToyView-v0"))
    with pytest.raises(ValueError, match="action space must be Box or Discrete"):
        make_policy("random", gym.wrappers.TransformAction(env, lambda a: a, gym.spaces.Text(3)))
