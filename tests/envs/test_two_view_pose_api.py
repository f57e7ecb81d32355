"""The environment as Gymnasium and Stable-Baselines3 use it: checkers, vectors, frames."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import two_view_pose  # noqa: F401  (registers the ids)
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from helpers.estimators import ConstantEstimator
from PIL import Image
from stable_baselines3.common.env_checker import check_env as check_env_sb3
from two_view_pose.envs.window import Window

IDS = ("TwoViewPose-v0", "TwoViewPoseDiscrete-v0", "TwoViewPoseSequential-v0")
REPLAY = "TwoViewPoseReplay-v0"  # renders nothing; see test_replay.py


@pytest.fixture
def small(objects) -> dict[str, Any]:
    """Arguments of a small environment."""
    return {"objects": objects, "estimator": ConstantEstimator(), "resolution": (120, 160)}


@pytest.fixture
def vector(small) -> Iterator[gym.vector.VectorEnv]:
    env = gym.make_vec("TwoViewPose-v0", num_envs=2, **small)
    yield env
    env.close()


def test_every_id_is_tested():
    assert {name for name in gym.registry if name.startswith("TwoViewPose")} == {*IDS, REPLAY}


@pytest.mark.slow
@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("estimated", [True, False])
def test_check_env_without_warnings(env_id, estimated, small, capsys):
    if not estimated:
        small["estimator"] = None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(env_id, **small)
        check_env(env.unwrapped)
        check_env_sb3(env.unwrapped, warn=True)
        env.close()
        env.close()
    assert "WARN" not in capsys.readouterr().err


@pytest.mark.slow
def test_vector_resets_in_the_same_step(vector, small):
    assert vector.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    first, infos = vector.reset(seed=[5, 6])
    after, rewards, terminated, truncated, infos = vector.step(np.zeros((2, 3), np.float32))
    assert terminated.all() and not truncated.any() and (rewards < 0).all()
    for i in range(2):
        single = gym.make("TwoViewPose-v0", **small)
        start, _ = single.reset(seed=5 + i)
        end, reward, *_ = single.step(np.zeros(3, np.float32))
        following, info = single.reset()
        single.close()
        assert rewards[i] == reward
        assert infos["scene_seed"][i] == info["scene_seed"]
        for key in start:
            np.testing.assert_array_equal(first[key][i], start[key])
            np.testing.assert_array_equal(infos["final_obs"][i][key], end[key])
            np.testing.assert_array_equal(after[key][i], following[key])
    assert "add_second" in infos["final_info"]["ground_truth"]
    assert "add_second" not in infos["ground_truth"]


@pytest.mark.slow
def test_vector_of_discrete_actions(small):
    env = gym.make_vec("TwoViewPoseDiscrete-v0", num_envs=2, **small)
    env.reset(seed=0)
    for _ in range(2):
        assert env.step(np.array([3, 21]))[2].all()
    env.close()


def test_sync_vector_env_with_same_step_autoreset(small):
    env = gym.make_vec(
        "TwoViewPose-v0",
        num_envs=1,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": "SameStep"},
        **small,
    )
    env.reset(seed=0)
    for _ in range(2):
        assert env.step(np.zeros((1, 3), np.float32))[2].all()
    env.close()


def test_frame(small):
    env = gym.make("TwoViewPose-v0", render_mode="rgb_array", **small)
    env.reset(seed=0)
    before = env.render()
    env.step(np.zeros(3))
    after = env.render()
    env.close()
    assert before.shape == after.shape == (664, 1360, 3)
    assert before.dtype == after.dtype == np.uint8
    middle = before.shape[1] // 2
    changed = (before != after).any(axis=(0, 2))
    assert changed[middle + 20 :].any() and not changed[: middle - 20].any()


@pytest.mark.slow
def test_frame_without_an_estimator(small):
    env = gym.make("TwoViewPose-v0", render_mode="rgb_array", **{**small, "estimator": None})
    env.reset(seed=0)
    env.step(np.zeros(3))
    assert env.render().shape == (664, 1360, 3)
    env.close()


def test_window_without_pygame_writes_a_file(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pygame", None)  # importing it fails
    window, frame = Window("test"), np.full((8, 12, 3), 77, np.uint8)
    window.show(frame)
    window.show(frame + 1)
    assert window.file is not None
    np.testing.assert_array_equal(np.asarray(Image.open(window.file)), frame + 1)
    printed = capsys.readouterr().err
    assert printed.count("pip install pygame") == 1 and str(window.file) in printed
    window.close()
    window.close()


def test_import_is_light():
    code = (
        "import sys, two_view_pose; print([m for m in ('torch', 'mujoco', 'stable_baselines3', "
        "'cv2', 'scipy') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"
