"""Several second views: budget, view cost and stop action."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from helpers.estimators import TableEstimator

SMALL = {"objects": ["duck"], "resolution": (120, 160), "image_size": 36}
SEQUENTIAL = "two_view_pose:TwoViewPoseSequential-v0"


@pytest.fixture(scope="module")
def env() -> Any:
    env = gym.make(SEQUENTIAL, estimator=TableEstimator(), **SMALL)
    yield env.unwrapped
    env.close()


@pytest.mark.slow
def test_check_env(env: Any) -> None:
    check_env(env, skip_render_check=True)


def test_the_budget_ends_the_episode(env: Any) -> None:
    observation, info = env.reset(seed=1)
    assert observation["views_left"] == 1.0 and not observation["taken"].any()
    assert info["second_views"] == 0
    travel = 0.0
    for count, action in enumerate((3, 20, 9), start=1):
        observation, reward, terminated, truncated, info = env.step(action)
        assert terminated == (count == 3) and truncated is False
        distance, travel = info["travel"] - travel, info["travel"]
        cost = 0.02 + 0.05 * distance
        error = info["ground_truth"]["add_second"] / info["diameter"]
        assert reward == pytest.approx(-cost - (min(error, 1.0) if terminated else 0.0))
        assert info["second_views"] == count == len(env.views) - 1
        assert observation["views_left"] == pytest.approx(1 - count / 3, abs=1e-6)
        assert np.flatnonzero(observation["taken"]).tolist() == sorted((3, 20, 9)[:count])
    with pytest.raises(ResetNeeded):
        env.step(0)


def test_stopping_costs_nothing(env: Any) -> None:
    _, info = env.reset(seed=2)
    first = info["ground_truth"]["add_first"]
    _, reward, terminated, _, info = env.step(env.stop_action)
    assert terminated and info["second_views"] == 0 and info["travel"] == 0.0
    assert info["ground_truth"]["add_second"] == first
    assert reward == pytest.approx(-min(first / info["diameter"], 1.0))


def test_views_are_counted_from_the_reference(env: Any) -> None:
    env.reset(seed=3)
    before = [env.camera_pose(action) for action in range(24)]
    env.step(23)
    after = [env.camera_pose(action) for action in range(24)]
    np.testing.assert_allclose(after, before)
    np.testing.assert_array_equal(env.T_newest_world, before[23])


def test_simulated_actions_leave_the_episode_unchanged(env: Any) -> None:
    env.reset(seed=4)
    env.step(1)
    simulated, again = env.simulate_actions([7, 7])
    assert again[1] == simulated[1] and len(env.views) == 2
    observation, reward, *_ = env.step(7)
    assert reward == simulated[1]
    for key, value in observation.items():
        np.testing.assert_array_equal(value, simulated[0][key])


def test_wrong_arguments() -> None:
    for arguments, message in (
        ({"budget": 0}, "budget must be 1 to 7"),
        ({"budget": 8}, "budget must be 1 to 7"),
        ({"view_weight": -0.1}, "view_weight"),
    ):
        with pytest.raises(ValueError, match=message):
            gym.make(SEQUENTIAL, estimator=None, **SMALL, **arguments)
