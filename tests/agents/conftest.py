"""The toy environment and its hyper-parameters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from two_view_pose.agents.training.config import TrainAgentConfig

HYPERPARAMETERS = """
ppo:
  ToyView-v0: &ppo
    n_timesteps: 128
    n_steps: 32
    batch_size: 32
    n_epochs: 4
    learning_rate: lin_1.0e-3
    policy_kwargs: &networks
      net_arch: [32]
      features_extractor_kwargs: {cnn_output_dim: 8}
  ToyViewDiscrete-v0: *ppo
  ToySphere-v0: *ppo
sac:
  ToyView-v0: &off
    n_timesteps: 60
    buffer_size: 40
    learning_starts: 16
    batch_size: 8
    policy_kwargs: *networks
dqn:
  ToyViewDiscrete-v0: *off
"""


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture
def hyperparameters(tmp_path: Path) -> Path:
    path = tmp_path / "hyperparameters.yml"
    path.write_text(HYPERPARAMETERS)
    return path


@pytest.fixture
def config(tmp_path: Path, hyperparameters: Path) -> Callable[..., TrainAgentConfig]:
    """Makes a training configuration on the toy environment."""

    def make(algo: str = "ppo", out: str = "agent", **fields: Any) -> TrainAgentConfig:
        env = (
            "helpers.toy_env:ToyViewDiscrete-v0" if algo == "dqn" else "helpers.toy_env:ToyView-v0"
        )
        defaults: dict[str, Any] = {
            "env": env,
            "estimator": None,
            "hyperparameters": hyperparameters,
            "progress": False,
            "checkpoint_every": 32,
        }
        return TrainAgentConfig(algo=algo, out=tmp_path / out, **{**defaults, **fields})

    return make
