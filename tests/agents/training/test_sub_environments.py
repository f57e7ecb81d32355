"""The SB3 adapter of the vector environment, compared with SB3's DummyVecEnv."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from two_view_pose.agents.training.config import TrainAgentConfig
from two_view_pose.agents.training.sub_environments import (
    SharedEstimatorVecEnv,
    has_vector_env,
    make_sub_environments,
)
from two_view_pose.agents.training.train_agent import train_agent

pytestmark = pytest.mark.slow

SMALL = {"objects": ("duck", "cat"), "estimator": None, "resolution": (120, 160), "image_size": 36}


@pytest.fixture
def make() -> Iterator[Callable[..., VecEnv]]:
    made = []

    def build(
        env_id: str = "TwoViewPose-v0", n_envs: int = 2, **kwargs: Any
    ) -> SharedEstimatorVecEnv:
        vector = gym.make_vec(env_id, num_envs=n_envs, **{"workers": 0, **SMALL, **kwargs})
        made.append(SharedEstimatorVecEnv(vector))
        return made[-1]

    yield build
    for env in made:
        env.close()


def check_equal(one: Any, other: Any) -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            check_equal(one[key], other[key])
    elif isinstance(one, list):
        for a, b in zip(one, other, strict=True):
            check_equal(a, b)
    else:
        assert getattr(one, "dtype", None) == getattr(other, "dtype", None) or np.ndim(one) == 0
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("env_id", ["TwoViewPose-v0", "TwoViewPoseDiscrete-v0"])
def test_equals_dummy_vec_env(env_id: str, make: Callable[..., VecEnv]) -> None:
    ours = make(env_id)
    theirs = DummyVecEnv([lambda: gym.make(env_id, **SMALL)] * 2)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    options = {"object": "cat"}
    for env in (ours, theirs):
        env.seed(5)
        env.set_options(options)
    check_equal(ours.reset(), theirs.reset())
    check_equal(ours.reset_infos, theirs.reset_infos)
    assert {info["object"] for info in ours.reset_infos} == {"cat"}
    ours.action_space.seed(0)
    for _ in range(3):
        actions = np.array([ours.action_space.sample() for _ in range(2)])
        for one, other in zip(ours.step(actions), theirs.step(actions), strict=True):
            check_equal(one, other)
        check_equal(ours.reset_infos, theirs.reset_infos)
    check_equal(ours.reset(), theirs.reset())  # seeds and options apply once
    theirs.close()


def test_attributes_and_methods_by_index(
    make: Callable[..., VecEnv],
) -> None:
    env = make(n_envs=3, render_mode="rgb_array")
    env.seed(0)
    env.reset()
    names = env.get_attr("object_name")
    assert len(names) == 3 and env.get_attr("object_name", 1) == names[1:2]
    env.set_attr("note", "seen", [0, 2])
    assert env.get_attr("note", [0, 2]) == ["seen"] * 2 and not env.has_attr("note")
    assert [p.shape for p in env.env_method("figure", indices=[2])] == [(664, 1360, 3)]
    assert env.env_is_wrapped(Monitor) == [False] * 3
    image = env.render()
    assert image is not None and image.shape == (2 * 664, 2 * 1360, 3)


def test_different_options_are_rejected(make: Callable[..., VecEnv]) -> None:
    env = make()
    env.set_options([{"object": "duck"}, {"object": "cat"}])
    with pytest.raises(ValueError, match="options must be the same"):
        env.reset()


def test_next_step_autoreset_is_rejected() -> None:
    vector = gym.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync")
    with pytest.raises(ValueError, match="autoreset_mode"):
        SharedEstimatorVecEnv(vector)
    vector.close()


def test_vector_environment_without_envs_is_rejected() -> None:
    vector = gym.make_vec("CartPole-v1", num_envs=2, vectorization_mode="vector_entry_point")
    vector.metadata = {**vector.metadata, "autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}
    with pytest.raises(ValueError, match="envs"):
        SharedEstimatorVecEnv(vector)
    vector.close()


def test_has_vector_env() -> None:
    assert has_vector_env("TwoViewPose-v0") and has_vector_env(
        "two_view_pose:TwoViewPoseDiscrete-v0"
    )
    assert not has_vector_env("TwoViewPoseSequential-v0") and not has_vector_env("CartPole-v1")


def test_monitor_records_episodes() -> None:
    env = make_sub_environments("TwoViewPose-v0", 2, {"workers": 0, **SMALL})
    env.seed(0)
    env.reset()
    _, rewards, done, infos = env.step(np.zeros((2, 3), np.float32))
    assert done.all()
    assert [info["episode"]["l"] for info in infos] == [1, 1]
    assert [info["episode"]["r"] for info in infos] == pytest.approx(rewards.tolist(), abs=1e-6)
    env.close()


def test_resumed_training_ends_with_the_same_weights(tmp_path: Path) -> None:
    yml = tmp_path / "hyperparameters.yml"
    yml.write_text(
        "ppo:\n  TwoViewPose-v0:\n    n_envs: 2\n    n_steps: 4\n    batch_size: 8\n"
        "    policy_kwargs:\n      net_arch: [16]\n"
        "      features_extractor_kwargs: {cnn_output_dim: 8}\n"
    )

    def train(out: str, steps: int) -> bytes:
        kwargs = {name: SMALL[name] for name in ("resolution", "image_size")}
        config = TrainAgentConfig(
            algo="ppo",
            steps=steps,
            out=tmp_path / out,
            objects=("duck", "cat"),
            estimator=None,
            hyperparameters=yml,
            checkpoint_every=8,
            progress=False,
            env_kwargs=kwargs,
        )
        return train_agent(config).read_bytes()

    whole = train("whole", 24)
    assert train("parts", 8) != whole
    assert train("parts", 24) == whole
