"""Vector environments that reset in the same step, which episodes of one step want.

``gym.make_vec`` finds these through ``vector_entry_point``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
from gymnasium.vector import AutoresetMode, SyncVectorEnv


def make_two_view_pose(num_envs: int = 1, **kwargs: Any) -> SyncVectorEnv:
    """Several ``TwoViewPose-v0`` in this process; ``kwargs`` go to each of them."""
    return _make("TwoViewPose-v0", num_envs, kwargs)


def make_two_view_pose_discrete(num_envs: int = 1, **kwargs: Any) -> SyncVectorEnv:
    """Several ``TwoViewPoseDiscrete-v0`` in this process; ``kwargs`` go to each of them."""
    return _make("TwoViewPoseDiscrete-v0", num_envs, kwargs)


def _make(env_id: str, num_envs: int, kwargs: dict[str, Any]) -> SyncVectorEnv:
    make_one: Callable[[], gym.Env[Any, Any]] = partial(gym.make, env_id, **kwargs)
    return SyncVectorEnv([make_one] * num_envs, autoreset_mode=AutoresetMode.SAME_STEP)
