"""Two-View Pose: what an episode returns, and what it depends on."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from helpers.estimators import (
    BatchedEstimator,
    ConstantEstimator,
    TableEstimator,
    pose,
    relative,
)
from helpers.workers import memory_of_episodes
from two_view_pose.core.geometry import invert, transform
from two_view_pose.envs.observation import CROP_SCALE
from two_view_pose.envs.simulation.carrier import PoseNoise, camera_center
from two_view_pose.envs.two_view_pose import CANDIDATE_VIEWS, TwoViewPoseDiscreteEnv


def same(first: Any, second: Any) -> bool:
    """Whether two nested dicts of arrays are equal to the byte."""
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[k], second[k]) for k in first)
    if isinstance(first, np.ndarray):
        return first.dtype == second.dtype and first.tobytes() == second.tobytes()
    return first == second


@pytest.mark.slow
def test_same_seed_same_bytes(make):
    outcomes = []
    for env in (make(estimator=TableEstimator()), make(estimator=TableEstimator())):
        rollout = []
        for episode in range(3):
            rollout.append(env.reset(seed=7 if episode == 0 else None))
            rollout.append(env.step(np.array([0.3, -0.2, 0.1])))
            rollout.append([view.image for view in env.views])
        outcomes.append(rollout)
    for first, second in zip(*outcomes, strict=True):
        assert all(same(a, b) for a, b in zip(first, second, strict=True))


def test_another_seed_is_another_scene(make):
    env = make()
    images = []
    for seed in (1, 2):
        env.reset(seed=seed)
        images.append(env.views[0].image)
    assert not np.array_equal(*images)


@pytest.mark.slow
@pytest.mark.parametrize("with_object", [False, True])
def test_an_episode_is_replayed_from_its_info(make, with_object):
    env = make()
    _, info = env.reset(seed=3)
    first = env.step(np.zeros(3))
    env.reset()
    options = {"scene_seed": info["scene_seed"]}
    if with_object:
        options["object"] = info["object"]
    _, again = env.reset(options=options)
    assert same(info, again)
    assert same(first[0], env.step(np.zeros(3))[0])


@pytest.mark.slow
def test_observations_are_fresh_and_in_the_space(make):
    env = make(estimator=ConstantEstimator(pose((0, 0, 0), (5.0, -7.0, 40.0)), sigma=1e6))
    seen = [env.reset(seed=0)[0], env.step(np.ones(3))[0], env.reset()[0]]
    for observation in seen:
        assert env.observation_space.contains(observation)
        for key, value in observation.items():
            assert value.dtype == env.observation_space[key].dtype
            assert not any(np.shares_memory(value, o[key]) for o in seen if o is not observation)
    np.testing.assert_array_equal(seen[0]["translation"], [1, -1, 3])  # clipped
    np.testing.assert_array_equal(seen[0]["uncertainty"], 2)


def test_nan_covariance_is_maximum_uncertainty(make):
    env = make(estimator=ConstantEstimator(sigma=np.nan))
    np.testing.assert_array_equal(env.reset(seed=0)[0]["uncertainty"], 2)


@pytest.mark.slow
def test_observation_follows_the_estimate_and_nothing_else(make):
    estimator = ConstantEstimator(sigma=0.02, score=0.75)
    env = make(estimator=estimator)
    for seed in range(4):
        for observation in (env.reset(seed=seed)[0], env.step(np.zeros(3))[0]):
            T = estimator.T_cam_obj
            np.testing.assert_allclose(observation["rotation"], T[:3, :2].T.ravel(), atol=1e-6)
            np.testing.assert_allclose(observation["translation"], T[:3, 3], atol=1e-6)
            np.testing.assert_allclose(observation["uncertainty"], np.log10(2.0), atol=1e-6)
            np.testing.assert_allclose(observation["score"], 0.75)


@pytest.mark.slow
def test_object_one_hot_and_order(make, objects):
    env = make()
    assert env.object_names == tuple(objects)
    for i, name in enumerate(objects):
        observation, info = env.reset(options={"object": name})
        np.testing.assert_array_equal(observation["object"], np.eye(len(objects))[i])
        assert info["object"] == name


def test_truth_is_only_under_ground_truth(make):
    env = make(estimator=ConstantEstimator())
    _, info = env.reset(seed=5)
    assert set(info["ground_truth"]) == {"T_cam_obj", "visibility", "add_first", "success"}
    *_, info = env.step(np.zeros(3))
    truth = info.pop("ground_truth")
    np.testing.assert_array_equal(info["T_cam_obj"], ConstantEstimator().T_cam_obj)
    assert 0 <= truth["visibility"] <= 1
    assert not np.allclose(truth["T_cam_obj"], info["T_cam_obj"])


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.0, 0.05, 2.0])
def test_reward(make, objects, weight):
    T_off = pose((0.02, -0.03, 0.05), (0.004, -0.003, 0.006))
    truth = make(travel_weight=weight)
    _, info = truth.reset(seed=11)
    T_true = info["ground_truth"]["T_cam_obj"]
    env = make(estimator=ConstantEstimator(T_true @ T_off), travel_weight=weight)
    env.reset(seed=11)
    _, reward, terminated, truncated, info = env.step(np.array([0.4, 0.1, -0.5]))
    model = objects[info["object"]]
    moved = transform(T_true @ T_off, model.points) - transform(T_true, model.points)
    add = np.sqrt((moved**2).sum(axis=1)).mean()
    centers = [camera_center(view.T_cam_world) for view in env.views]
    travel = np.sqrt(((centers[1] - centers[0]) ** 2).sum())
    assert info["travel"] == pytest.approx(travel)
    assert info["ground_truth"]["add_second"] == pytest.approx(add)
    assert info["ground_truth"]["success"] is bool(add < 0.1 * model.diameter)
    assert reward == pytest.approx(-add / model.diameter - weight * travel)
    assert type(reward) is float
    assert terminated is True and truncated is False


def test_the_error_in_the_reward_is_clipped_to_one(make):
    env = make(estimator=ConstantEstimator(pose((0, 0, 0), (0, 0, 9.0))), travel_weight=0.0)
    env.reset(seed=0)
    assert env.step(np.zeros(3))[1] == -1.0


def test_reward_without_an_estimator_is_the_travel_cost(make):
    env = make()
    observation, info = env.reset(seed=2)
    for key in ("rotation", "translation", "uncertainty", "score"):
        np.testing.assert_array_equal(observation[key], 0)
    assert "add_first" not in info["ground_truth"]
    observation, reward, terminated, _, info = env.step(np.ones(3))
    assert reward == pytest.approx(-0.05 * info["travel"])
    assert reward < 0 and terminated


def test_action_is_a_viewpoint_on_the_sphere_around_the_estimate(make):
    env = make(estimator=TableEstimator())
    env.reset(seed=4)
    center = np.array([0.0, 0.0, 0.03])
    np.testing.assert_allclose(env.sphere_center, center, atol=1e-12)
    reference = camera_center(env.views[0].T_cam_world) - center
    for action, offset, elevation, distance in (
        ((-1, -1, -1), -90, 7, 0.6),
        ((1, 1, 1), 90, 82, 1.4),
        ((0, 0, 0), 0, 44.5, 1.0),
        ((0.5, -0.2, 0.25), 45, 37, 1.1),
    ):
        T_cam_world = env.camera_pose(np.array(action, dtype=np.float32))
        x, y, z = camera_center(T_cam_world) - center
        assert np.linalg.norm((x, y, z)) == pytest.approx(distance, abs=1e-6)
        assert np.rad2deg(np.arcsin(z / distance)) == pytest.approx(elevation, abs=1e-4)
        difference = np.rad2deg(np.arctan2(y, x) - np.arctan2(reference[1], reference[0]))
        assert (difference - offset + 180) % 360 - 180 == pytest.approx(0, abs=1e-4)
        x, y, z = transform(T_cam_world, center)  # it looks at the center, without roll
        np.testing.assert_allclose((x, y), 0, atol=1e-9)
        assert invert(T_cam_world)[2, 0] == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_an_implausible_estimate_keeps_the_camera_above_the_table(make):
    for translation in ((0, 0, -3.0), (8, 8, 8), (0, 50, 1)):
        env = make(estimator=ConstantEstimator(pose((0, 0, 0), translation)))
        env.reset(seed=1)
        assert camera_center(env.camera_pose(np.array([1, -1, -1])))[2] > 0.05


def test_camera_observation(make):
    env = make(estimator=TableEstimator())
    place = {"distance": 0.9, "azimuth": 0.7, "elevation": 0.6}
    observation, info = env.reset(seed=0, options={"reference_camera": place})
    x, y, z = camera_center(info["T_cam_world"])
    np.testing.assert_allclose(
        (np.hypot(np.hypot(x, y), z), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))),
        tuple(place.values()),
    )
    distance, elevation = np.hypot(np.hypot(x, y), z - 0.03), np.arctan2(z - 0.03, np.hypot(x, y))
    expected = (distance, np.sin(elevation), np.cos(elevation), 0, 1, 0, 1)
    np.testing.assert_allclose(observation["camera"], expected, atol=1e-6)
    observation, *_ = env.step(np.array([1.0, 1.0, 1.0]))
    high = np.deg2rad(82)
    expected = (1.4, np.sin(high), np.cos(high), 1, 0, 0, 1)
    np.testing.assert_allclose(observation["camera"], expected, atol=1e-5)


def test_crop_shows_the_detection_and_what_is_around_it(make):
    estimator = ConstantEstimator()
    estimator.roi = replace(estimator.roi, side=60 / CROP_SCALE)
    env = make(estimator=estimator, image_size=60)  # the side of the crop: one to one
    observation, _ = env.reset(seed=0)
    image = env.views[0].image
    half = 0.5 * (image[30:90, 50:110].astype(float) + image[31:91, 51:111])  # center 80, 60
    assert np.abs(observation["image"].astype(float) - half).mean() < 6
    assert env.observation_space["image"].shape == (60, 60, 3)


@pytest.mark.slow
def test_pose_noise_reaches_the_estimator_only(make):
    poses, seen = [], []
    for noise in (None, PoseNoise(2.0, 0.01), (2.0, 0.01)):
        estimator = ConstantEstimator()
        env = make(estimator=estimator, pose_noise=noise)
        env.reset(seed=9)
        *_, info = env.step(np.array([0.5, 0.0, 0.0]))
        poses.append(relative(estimator.calls[-1][0]))
        info["images"] = np.stack([view.image for view in env.views])
        info["reference"] = estimator.calls[-1][0][0].T_cam_world
        seen.append(info)
    assert same(seen[0], seen[1]) and same(seen[0], seen[2])
    np.testing.assert_array_equal(poses[1], poses[2])
    error = poses[1] @ invert(poses[0])
    angle = np.rad2deg(np.arccos((np.trace(error[:3, :3]) - 1) / 2))
    assert 0.1 < angle < 12 and 1e-4 < np.linalg.norm(error[:3, 3]) < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("batched", [True, False])
def test_simulated_actions_are_steps(make, batched):
    estimator = BatchedEstimator() if batched else TableEstimator()
    env = make(TwoViewPoseDiscreteEnv, estimator=estimator, pose_noise=(0.5, 0.003))
    env.reset(seed=6)
    assert env.simulate_actions([]) == []
    simulated = env.simulate_actions(range(12))
    if batched:
        assert estimator.batches == [(2,) * 8, (2,) * 4]
    assert len(env.views) == 1  # the episode is as it was
    for action, (observation, reward, *ends, info) in enumerate(simulated):
        (once,) = env.simulate_actions([action])
        stepped = env.step(action)
        env.reset(seed=6)
        for other in (once, stepped):
            assert same(observation, other[0]) and same(info, other[4])
            assert [reward, *ends] == list(other[1:4])


@pytest.mark.slow
def test_candidate_views(make):
    env = make(TwoViewPoseDiscreteEnv, estimator=TableEstimator())
    assert env.action_space == gym.spaces.Discrete(24) and len(CANDIDATE_VIEWS) == 24
    env.reset(seed=1)
    center = np.array([0.0, 0.0, 0.03])
    reference = camera_center(env.views[0].T_cam_world) - center
    for i in (0, np.int64(10), np.array(23)):
        x, y, z = camera_center(env.camera_pose(i)) - center
        offset, elevation = CANDIDATE_VIEWS[int(i)]
        radius = np.clip(np.linalg.norm(reference), 0.6, 1.4)
        assert np.linalg.norm((x, y, z)) == pytest.approx(radius)
        assert np.rad2deg(np.arcsin(z / radius)) == pytest.approx(elevation)
        difference = np.rad2deg(np.arctan2(y, x) - np.arctan2(reference[1], reference[0]))
        assert (difference - offset + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)
    assert make(TwoViewPoseDiscreteEnv, candidate_views=[(30, 45)]).action_space.n == 1


@pytest.mark.slow
def test_reference_camera_as_a_matrix(make):
    env = make()
    _, info = env.reset(seed=0)
    _, again = env.reset(seed=1, options={"reference_camera": info["T_cam_world"]})
    np.testing.assert_allclose(again["T_cam_world"], info["T_cam_world"], atol=1e-12)


@pytest.mark.slow
def test_memory_stays_flat(objects):
    """In a process of its own: one that ran other tests first holds what those freed."""
    with ProcessPoolExecutor(1, get_context("spawn")) as worker:
        held = worker.submit(memory_of_episodes, objects, 400, every=100).result()
    assert held[3] - held[1] < 2e6, held  # 10 kB an episode, after a warm-up of 200
