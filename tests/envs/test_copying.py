"""Environments that are copied, pickled, and used in several threads."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from helpers.estimators import ConstantEstimator
from two_view_pose.envs.sequential import TwoViewPoseSequentialEnv
from two_view_pose.envs.two_view_pose import TwoViewPoseDiscreteEnv, TwoViewPoseEnv
from two_view_pose.envs.vector.env import TwoViewPoseVectorEnv
from two_view_pose.envs.view_banks.bank import ViewBank

Make = Callable[..., Any]


def assert_same(one: tuple[Any, ...], other: tuple[Any, ...]) -> None:
    """Whether two steps have the same observation, reward and flags."""
    for key, value in one[0].items():
        np.testing.assert_array_equal(value, other[0][key])
    assert one[1:4] == other[1:4]


@pytest.mark.parametrize("kind", [TwoViewPoseEnv, TwoViewPoseDiscreteEnv, TwoViewPoseSequentialEnv])
def test_a_copy_continues_the_episode_by_itself(kind: type, make: Make) -> None:
    estimator = ConstantEstimator()
    env, other = (make(kind, estimator=estimator, render_mode="rgb_array") for _ in range(2))
    for one in (env, other):
        one.reset(seed=3)
        one.action_space.seed(0)
    copied = copy.deepcopy(env)
    action = other.action_space.sample()
    env.reset(seed=8)  # another scene, which the copy must not see
    expected = other.step(action)
    assert_same(copied.step(action), expected)
    for mine, theirs in zip(copied.views, other.views, strict=True):
        np.testing.assert_array_equal(mine.image, theirs.image)
    np.testing.assert_array_equal(copied.reset()[0]["image"], other.reset()[0]["image"])
    assert len(estimator.calls) == 7  # it is shared
    copied.close()


def test_a_pickled_environment_continues_the_episode(make: Make) -> None:
    env = make()
    env.reset(seed=3)
    again = pickle.loads(pickle.dumps(env))
    action = env.action_space.sample()
    assert_same(again.step(action), env.step(action))
    np.testing.assert_array_equal(again.views[1].image, env.views[1].image)
    again.close()


def test_a_copy_of_a_replay_shares_its_bank(make_bank: Callable[..., ViewBank]) -> None:
    env = gym.make("two_view_pose:TwoViewPoseReplay-v0", bank=make_bank(4))
    env.reset(seed=0)
    copied = copy.deepcopy(env)
    assert copied.unwrapped.bank is env.unwrapped.bank
    assert_same(copied.step(5), env.step(5))
    assert copied.reset()[1]["scene_seed"] == env.reset()[1]["scene_seed"]


def test_a_vector_environment_says_that_it_cannot_be_copied(objects: dict[str, Any]) -> None:
    small = {"objects": objects, "estimator": None, "resolution": (120, 160)}
    env = TwoViewPoseVectorEnv(TwoViewPoseEnv, 2, workers=0, **small)
    with pytest.raises(TypeError, match="a vector environment cannot be copied"):
        copy.deepcopy(env)
    env.close()


def test_an_environment_may_change_its_thread(make: Make) -> None:
    env, other = make(), make()
    other.reset(seed=3)
    expected = other.step(np.zeros(3, np.float32))
    with ThreadPoolExecutor(1) as first, ThreadPoolExecutor(1) as second:
        for thread in (first, second, first):
            thread.submit(env.reset, seed=3).result()
            assert_same(second.submit(env.step, np.zeros(3, np.float32)).result(), expected)
        env.reset(seed=3)
        first.submit(env.close).result()
    assert_same((env.reset(seed=3)[0], 0, 0, 0), (other.reset(seed=3)[0], 0, 0, 0))


def test_environments_in_threads_of_their_own_agree(make: Make) -> None:
    envs = [make() for _ in range(3)]
    together = Barrier(len(envs))

    def play(env: TwoViewPoseEnv) -> Any:
        env.reset(seed=4)
        together.wait(timeout=60)
        return [env.step(np.zeros(3, np.float32)), env.views[1].image]

    with ThreadPoolExecutor(len(envs)) as pool:
        played = list(pool.map(play, envs))
    for step, image in played[1:]:
        assert_same(step, played[0][0])
        np.testing.assert_array_equal(image, played[0][1])
