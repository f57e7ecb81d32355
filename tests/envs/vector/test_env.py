"""Sub-environments of a vector environment against single ones, and what goes wrong in them."""

import multiprocessing
import os
import signal
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from helpers.estimators import BatchedEstimator, ConstantEstimator, TableEstimator
from two_view_pose.envs.sequential import TwoViewPoseSequentialEnv
from two_view_pose.envs.simulation.randomization import Randomization
from two_view_pose.envs.simulation.scene import SceneConfig
from two_view_pose.envs.simulation.simulator import SceneRequest, SceneSimulator
from two_view_pose.envs.two_view_pose import TwoViewPoseDiscreteEnv, TwoViewPoseEnv
from two_view_pose.envs.vector.env import TwoViewPoseVectorEnv
from two_view_pose.envs.vector.remote_simulator import SimulatorWorkers

ENVS = 3


@pytest.fixture
def make_vector(objects):
    made = []

    def build(env_cls=TwoViewPoseEnv, num_envs=ENVS, **kwargs) -> TwoViewPoseVectorEnv:
        small = {"objects": objects, "estimator": None, "resolution": (120, 160)}
        made.append(TwoViewPoseVectorEnv(env_cls, num_envs, **{**small, **kwargs}))
        return made[-1]

    yield build
    for env in made:
        env.close()


def check_equal(one, other):
    assert type(one) is type(other) or np.ndim(one) == 0
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            check_equal(one[key], other[key])
    else:
        np.testing.assert_array_equal(one, other)


def info_of(infos, i):
    """One sub-environment's info, as the single environment gives it."""
    return {
        key: info_of(value, i) if isinstance(value, dict) else value[i]
        for key, value in infos.items()
        if not key.startswith("_")
    }


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 2])
def test_every_sub_environment_is_a_single_environment(make_vector, make, workers):
    estimator = BatchedEstimator()
    options = {"scene": "clutter", "pose_noise": (0.5, 0.003), "image_size": 40}
    vector = make_vector(workers=workers, estimator=estimator, **options)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (2, ENVS, 3)).astype(np.float32)
    first, first_info = vector.reset(seed=7)
    steps = [vector.step(a) for a in actions]
    for i in range(ENVS):
        single = make(estimator=TableEstimator(), **options)
        observation, info = single.reset(seed=7 + i)
        check_equal({key: value[i] for key, value in first.items()}, observation)
        check_equal(info_of(first_info, i), info)
        for now, (after, rewards, terminated, truncated, infos) in zip(actions, steps, strict=True):
            final, reward, *_, info = single.step(now[i])
            assert rewards[i] == reward and terminated[i] and not truncated[i]
            check_equal(infos["final_obs"][i], final)
            check_equal(info_of(infos["final_info"], i), info)
            observation, info = single.reset()
            check_equal({key: value[i] for key, value in after.items()}, observation)
            rest = {k: v for k, v in infos.items() if not k.startswith("final")}
            check_equal(info_of(rest, i), info)
    # They are estimated together, in two parts, first with one view and then with two.
    assert sorted(estimator.batches[:2]) == [(1,), (1, 1)]
    assert sorted(estimator.batches[2:4]) == [(2,), (2, 2)]
    assert sum(map(len, estimator.batches)) == ENVS * (1 + 2 * 2)


@pytest.mark.slow
def test_estimator_without_batches(make_vector):
    estimator = ConstantEstimator()
    vector = make_vector(TwoViewPoseDiscreteEnv, estimator=estimator, workers=0)
    vector.reset(seed=0)
    vector.step(np.array([3, 0, 23]))
    assert [len(views) for views, _ in estimator.calls] == [1] * 3 + [2] * 3 + [1] * 3


@pytest.mark.slow
def test_images_of_an_episode_stay_while_the_next_begins(make_vector):
    vector = make_vector(workers=1, estimator=TableEstimator())
    vector.reset(seed=0)
    shown = [views[0].image for views in vector.get_attr("views")]
    before = [image.copy() for image in shown]
    vector.step(np.zeros((ENVS, 3), np.float32))
    for image, copy in zip(shown, before, strict=True):
        np.testing.assert_array_equal(image, copy)


@pytest.mark.slow
def test_a_wrong_action_moves_no_camera(make_vector):
    vector = make_vector(workers=1)
    vector.reset(seed=0)
    actions = np.zeros((ENVS, 3), np.float32)
    wrong = actions.copy()
    wrong[2, 1] = np.nan
    with pytest.raises(ValueError, match="action"):
        vector.step(wrong)
    assert vector.step(actions)[2].all()


@pytest.mark.slow
def test_reset_after_an_estimator_failed(make_vector, objects):
    class Fails(TableEstimator):
        broken = False

        def estimate(self, views, object_name):
            if self.broken:
                raise RuntimeError("estimator failed")
            return super().estimate(views, object_name)

    estimator = Fails()
    vector = make_vector(workers=2, estimator=estimator)
    expected, _ = vector.reset(seed=3)
    estimator.broken = True
    with pytest.raises(RuntimeError, match="estimator failed"):
        vector.step(np.zeros((ENVS, 3), np.float32))
    estimator.broken = False
    again, _ = vector.reset(seed=3)
    check_equal(again, expected)


@pytest.mark.slow
def test_killed_worker(make_vector):
    vector = make_vector(workers=1)
    vector.reset(seed=0)
    (worker,) = multiprocessing.active_children()
    os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(ChildProcessError, match=r"sub-environment 0 died.*fewer workers"):
        for _ in range(3):
            vector.step(np.zeros((ENVS, 3), np.float32))
    with pytest.raises(ChildProcessError, match="sub-environment 0 died"):
        vector.reset(seed=0)


def test_unknown_reset_options(make_vector):
    vector = make_vector(workers=0)
    with pytest.raises(ValueError, match="unknown reset option"):
        vector.reset(options={"weather": "rain"})


@pytest.mark.slow
def test_errors_of_a_remote_simulator_are_raised_here(objects):
    workers = SimulatorWorkers(1)
    simulator = workers.add(objects, SceneConfig(), Randomization(), (36, 48))
    with pytest.raises(ValueError, match="T_cam_world must"):
        simulator.render(np.zeros((4, 4)), 0)
    scene = simulator.reset(SceneRequest(3, "ball"))
    assert scene.object_name == "ball" and scene.image.shape == (36, 48, 3)
    local = SceneSimulator(objects, SceneConfig(), Randomization(), (36, 48))
    np.testing.assert_array_equal(local.reset(SceneRequest(3, "ball")).image, scene.image)
    local.close()
    workers.close()


@pytest.mark.parametrize(
    "arguments, text",
    [
        ({"num_envs": 0}, "num_envs"),
        ({"workers": -1}, "workers"),
        ({"image_size": 3}, "image_size"),
    ],
)
def test_arguments_are_checked(make_vector, arguments, text):
    with pytest.raises(ValueError, match=text):
        make_vector(**arguments)


def test_sequential_environment_is_refused(make_vector):
    with pytest.raises(ValueError, match="SyncVectorEnv"):
        make_vector(TwoViewPoseSequentialEnv)


def test_one_seed_for_each_sub_environment(make_vector):
    vector = make_vector(workers=0)
    with pytest.raises(ValueError, match="3 envs"):
        vector.reset(seed=[1, 2])


@pytest.mark.slow
def test_call_and_get_attr(make_vector):
    vector = make_vector(workers=0, render_mode="rgb_array", travel_weight=0.5)
    vector.reset(seed=0)
    assert vector.get_attr("travel_weight") == (0.5,) * ENVS
    assert vector.call("visibility_from", vector.envs[0].T_cam_world)[0] >= 0
    assert [frame.shape for frame in vector.render()] == [(664, 1360, 3)] * ENVS


def test_square_images_are_a_center_crop(make):
    env = make(resolution=(84, 84), image_size=84, render_mode="rgb_array")
    observation, _ = env.reset(seed=0)
    assert observation["image"].shape == (84, 84, 3)
    assert env.intrinsics[0, 0] == pytest.approx(572.4114 * 84 / 480)
    env.step(np.zeros(3, np.float32))
    assert env.render().ndim == 3


@pytest.mark.slow
def test_make_vec(objects):
    env = gym.make_vec(
        "TwoViewPoseDiscrete-v0",
        num_envs=2,
        objects=objects,
        estimator=None,
        resolution=(120, 160),
        workers=1,
    )
    assert isinstance(env.unwrapped, TwoViewPoseVectorEnv)
    env.reset(seed=0)
    assert env.step(np.array([1, 2]))[2].all()
    env.close()


SCRIPT = """
import gymnasium as gym
from two_view_pose.envs.simulation.scene import SceneConfig
class OwnConfig(SceneConfig):
    pass
envs = gym.make_vec("two_view_pose:TwoViewPose-v0", num_envs=2, estimator=None,
                    resolution=(36, 48), image_size=36, objects=("duck",), scene={scene})
envs.reset(seed=0)
envs.close()
"""


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "works"), [("SceneConfig()", True), ("OwnConfig()", False)])
def test_script_without_a_main_guard(scene, works, tmp_path):
    """Workers do not rerun the script, unless it defines a class of an argument: an error."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(scene=scene))
    command = [sys.executable, os.fspath(script)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert (done.returncode == 0) == works, done.stderr
    if not works:
        assert "if __name__ == '__main__'" in done.stderr
        assert "ChildProcessError: the process that renders sub-environment 0 died" in done.stderr
