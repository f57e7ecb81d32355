"""Two-View Pose: invalid arguments, actions and options."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from helpers.estimators import ConstantEstimator, PickyEstimator
from two_view_pose.envs.two_view_pose import TwoViewPoseDiscreteEnv


@pytest.mark.slow
@pytest.mark.parametrize(
    "action",
    [
        np.array([np.nan, 0, 0]),
        np.array([0, np.inf, 0]),
        np.array([0, 0, 1.01]),
        np.zeros(2),
        np.zeros((1, 3)),
        None,
        "left",
        ["a", "b", "c"],
    ],
)
def test_bad_actions(make, action):
    env = make()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action must be three numbers from -1 to 1"):
        env.step(action)
    env.step(np.zeros(3))  # the episode continues after the error


@pytest.mark.slow
@pytest.mark.parametrize("action", [-1, 24, 1.5, True, np.array([3, 4]), None, float("nan")])
def test_bad_discrete_actions(make, action):
    env = make(TwoViewPoseDiscreteEnv)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action must be an integer from 0 to 23"):
        env.step(action)


@pytest.mark.parametrize(
    "views", [[], [(1, 2, 3)], [(0, 5)], [(200, 45)], [(np.nan, 45)], [(0, 90)]]
)
def test_bad_candidate_views(make, views):
    with pytest.raises(ValueError, match="candidate_views must be pairs"):
        make(TwoViewPoseDiscreteEnv, candidate_views=views)


def test_step_needs_a_reset(make):
    env = make()
    for call in (lambda: env.step(np.zeros(3)), lambda: env.sphere_center, lambda: env.figure()):
        with pytest.raises(ResetNeeded, match="reset"):
            call()
    env.reset(seed=0)
    env.step(np.zeros(3))
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(np.zeros(3))


def test_unknown_object_names_the_training_command(make):
    with pytest.raises(ValueError, match=r"ball.*train-estimator --objects"):
        make(estimator=PickyEstimator())


def test_own_estimator_without_object_names(make):
    make(estimator=ConstantEstimator()).reset(seed=0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"estimator": 3}, "estimator must be"),
        ({"estimator": "guess"}, "unknown method"),
        ({"scene": "kitchen"}, "scene kind"),
        ({"travel_weight": -1.0}, "travel_weight"),
        ({"travel_weight": np.nan}, "travel_weight"),
        ({"pose_noise": (1.0,)}, "pose_noise"),
        ({"pose_noise": (-1.0, 0.0)}, "pose_noise.rotation_deg"),
        ({"image_size": 8}, "image_size"),
        ({"resolution": (0, 100)}, "resolution"),
        ({"render_mode": "ascii"}, "render_mode"),
        ({"objects": ["unicorn"]}, "unicorn"),
    ],
)
def test_bad_arguments(make, arguments, message):
    with pytest.raises(ValueError, match=message):
        make(**arguments)


def test_estimator_returns_an_invalid_pose(make):
    env = make(estimator=ConstantEstimator(np.full((4, 4), np.nan)))
    with pytest.raises(ValueError, match="the estimator's T_cam_obj"):
        env.reset(seed=0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sceneseed": 1}, "sceneseed.*object, scene_seed, reference_camera"),
        ({"object": "unicorn"}, "object must be one of brick"),
        ({"scene_seed": -1}, "scene_seed"),
        ({"scene_seed": 1.5}, "scene_seed"),
        ({"scene_seed": True}, "scene_seed"),
        ({"reference_camera": np.full((4, 4), np.nan)}, "reference_camera"),
        ({"reference_camera": np.eye(3)}, "reference_camera"),
        ({"reference_camera": np.diag([1, 1, -1, 1])}, "reference_camera"),
        ({"reference_camera": "above"}, "reference_camera"),
        ({"reference_camera": {"distance": 1.0}}, "distance, azimuth, elevation"),
        ({"reference_camera": {"distance": 1, "azimuth": 0, "elevation": 45}}, "elevation.*rad"),
        ({"reference_camera": {"distance": 9, "azimuth": 0, "elevation": 1}}, "distance.*1.4 m"),
        ({"reference_camera": {"distance": 1, "azimuth": np.nan, "elevation": 1}}, "azimuth"),
        ([], "options must be a dict"),
    ],
)
def test_bad_options(make, options, message):
    with pytest.raises(ValueError, match=message):
        make().reset(options=options)


@pytest.mark.slow
def test_bad_options_draw_nothing(make):
    refused, untouched = make(), make()
    for env in (refused, untouched):
        env.reset(seed=3)
    with pytest.raises(ValueError, match="sceneseed"):
        refused.reset(options={"sceneseed": 1})
    assert refused.reset()[1]["scene_seed"] == untouched.reset()[1]["scene_seed"]
