"""Training and evaluation in the rendered environments."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import tyro
from two_view_pose.agents.evaluation.evaluate_agent import evaluate_agents
from two_view_pose.agents.evaluation.outcomes import STAY
from two_view_pose.agents.policies.registry import make_policy
from two_view_pose.agents.training.config import EvaluateAgentConfig, TrainAgentConfig
from two_view_pose.agents.training.train_agent import train_agent
from two_view_pose.core.geometry import View
from two_view_pose.pose_estimator.types import PoseEstimate

pytestmark = pytest.mark.slow

OBJECTS = ("duck", "cat")
SMALL = {"resolution": (120, 160), "image_size": 36}

HYPERPARAMETERS = """
{algo}:
  {env}:
    {arguments}
    policy_kwargs:
      net_arch: [16]
      features_extractor_kwargs: {{cnn_output_dim: 8}}
"""


class ConstantEstimator:
    """Estimates every object one meter in front of the camera."""

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate:
        T_cam_obj = np.eye(4)
        T_cam_obj[2, 3] = 1.0
        return PoseEstimate(T_cam_obj, np.zeros((9, 3)), np.zeros((9, 3, 3)), [])


@pytest.mark.parametrize(
    ("algo", "env_id", "arguments"),
    [
        ("ppo", "TwoViewPose-v0", "n_steps: 8\n    batch_size: 8"),
        ("ppo", "TwoViewPose-v0", "n_envs: 2\n    n_steps: 4\n    batch_size: 8"),
        ("dqn", "TwoViewPoseDiscrete-v0", "learning_starts: 4\n    buffer_size: 16"),
    ],
)
def test_train_and_evaluate(
    algo: str, env_id: str, arguments: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    yml = tmp_path / "hyperparameters.yml"
    yml.write_text(HYPERPARAMETERS.format(algo=algo, env=env_id, arguments=arguments))
    path = train_agent(
        TrainAgentConfig(
            algo=algo,
            steps=16,
            out=tmp_path / "agent",
            objects=OBJECTS,
            estimator=None,
            hyperparameters=yml,
            checkpoint_every=8,
            progress=False,
            env_kwargs=SMALL,
        )
    )
    printed = capsys.readouterr().out.partition("two_view_pose evaluate-agent ")[2]
    config = tyro.cli(EvaluateAgentConfig, args=shlex.split(printed))  # the printed command
    assert config.policy == ("random", "fixed", "max-baseline", str(path))
    estimator = {**SMALL, "estimator": ConstantEstimator()}
    records = evaluate_agents(replace(config, episodes=4, progress=False, env_kwargs=estimator))
    rows = {
        (r["policy"], r["metric"]): r["value"]
        for r in records
        if r["object"] == "mean" and "against" not in r and "visibility" not in r
    }
    # The estimate does not depend on the views, so all errors on the same scenes are equal.
    errors = {rows[name, "add_over_diameter"] for name in (STAY, "random", str(path))}
    assert len(errors) == 1
    assert rows[STAY, "travel"] == 0.0
    assert rows["max-baseline", "travel"] > 0.5


@pytest.mark.parametrize("env_id", ["TwoViewPose-v0", "TwoViewPoseDiscrete-v0"])
def test_baseline_angles_of_policies(env_id: str) -> None:
    env = gym.make(env_id, objects=["duck"], estimator=None, **SMALL)
    angles: dict[str, list[float]] = {
        name: [] for name in ("random", "fixed", "above", "max-baseline")
    }
    for name in ("random", "fixed", "above", "max-baseline"):
        policy = make_policy(name, env)
        for seed in range(4):
            observation, _ = env.reset(seed=seed)
            policy.reset(np.random.default_rng(seed))
            info = env.step(policy.act(observation))[4]
            angles[name].append(info["baseline_deg"])
    env.close()
    assert (np.array(angles["max-baseline"]) >= np.array(angles["random"])).all()
    # 30 degrees in azimuth are less on the sphere, by the cosine of the elevation.
    assert max(angles["fixed"]) < (30.1 if env_id == "TwoViewPose-v0" else 45.0)
