"""The Fisher-information policy, compared with closed forms."""

from __future__ import annotations

from collections.abc import Callable

import gymnasium as gym
import numpy as np
import pytest
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.agents.policies.uncertainty import predicted_variance
from two_view_pose.core.geometry import LINEMOD_K, invert
from two_view_pose.envs.simulation.camera import view_sphere_pose
from two_view_pose.envs.view_banks.bank import ViewBank

CENTER = np.array([0.0, 0.0, 0.0])
REFERENCE = view_sphere_pose(CENTER, 1.0, 0.0, 0.5)


def second(azimuth: float, distance: float = 1.0) -> np.ndarray:
    return view_sphere_pose(CENTER, distance, azimuth, 0.5) @ invert(REFERENCE)


def test_side_view_reduces_depth_variance() -> None:
    keypoints = np.array([[0.0, 0.0, 1.0]] * 9)
    deep = np.tile(np.diag([1e-6, 1e-6, 1e-2]), (9, 1, 1))
    before = np.trace(deep, axis1=1, axis2=2).sum()
    left = [predicted_variance(keypoints, deep, second(a), LINEMOD_K) for a in (0.0, 0.5, 1.0)]
    assert before * 1.0001 > left[0] > 100 * left[1] > 100 * left[2]
    near = predicted_variance(keypoints, deep, second(1.0, 0.6), LINEMOD_K)
    assert near < left[2]


def test_posterior_variance_of_one_coordinate() -> None:
    # A camera straight ahead of a point one meter away measures x with fx pixels a meter.
    keypoints = np.array([[0.0, 0.0, 1.0]])
    wide = np.diag([1e-2, 1e-12, 1e-12])[None]
    left = predicted_variance(keypoints, wide, np.eye(4), LINEMOD_K, deviation=2.0)
    expected = 1.0 / (1e2 + (LINEMOD_K[0, 0] / 2.0) ** 2)
    assert left == pytest.approx(expected, rel=1e-3)


def test_uncertain_depth_gives_wide_baseline(
    make_bank: Callable[..., ViewBank],
) -> None:
    bank = make_bank(4)
    # Uncertain along the line of sight of the reference camera.
    bank.covariance[:] = np.diag([1e-6, 1e-6, 1e-2])
    env = gym.make("two_view_pose:TwoViewPoseReplay-v0", bank=bank)
    policy = make_policy("uncertainty", env)
    for scene in range(4):
        observation, _ = env.reset(options={"scene": scene})
        angle = env.step(policy.act(observation))[4]["baseline_deg"]
        angles = []
        for slot in range(24):
            env.reset(options={"scene": scene})
            angles.append(env.step(slot)[4]["baseline_deg"])
        assert angle > np.quantile(angles, 0.7)


@pytest.mark.slow
def test_uncertainty_needs_an_estimator() -> None:
    env = gym.make(
        "two_view_pose:TwoViewPose-v0", objects=["duck"], estimator=None, resolution=(120, 160)
    )
    observation, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match="uncertainty needs an environment with an estimator"):
        make_policy("uncertainty", env).act(observation)
    env.close()
