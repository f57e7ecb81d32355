"""A Gymnasium vector environment as Stable-Baselines3 wants its environments.

SB3 has vector environments of its own, which run single ones in turn or in a process each, each
with an estimator. ``TwoViewPoseVectorEnv`` asks one estimator for all sub-environments at once.
"""

from __future__ import annotations

import importlib
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers.vector import DictInfoToList
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from ...core.errors import InputError


def has_vector_env(env_id: str) -> bool:
    """Whether several of an environment are a ``TwoViewPoseVectorEnv``."""
    module, _, name = env_id.rpartition(":")
    if module:
        importlib.import_module(module)  # where the id is registered
    entry = gym.spec(name).vector_entry_point
    return isinstance(entry, str) and entry.startswith("two_view_pose.")


def make_sub_environments(
    env_id: str, n_envs: int = 1, env_kwargs: dict[str, Any] | None = None
) -> VecEnv:
    """Makes sub-environments that share one estimator, monitored as SB3's ``make_vec_env`` does.

    Args:
        env_id: an id for which :func:`has_vector_env` holds.
        n_envs: how many sub-environments.
        env_kwargs: arguments of ``gymnasium.make_vec``.
    """
    return VecMonitor(
        SharedEstimatorVecEnv(gym.make_vec(env_id, num_envs=n_envs, **env_kwargs or {}))
    )


class SharedEstimatorVecEnv(DummyVecEnv):
    """The sub-environments of a vector environment, for SB3's trainers.

    Observations, rewards and infos are those of SB3's ``DummyVecEnv`` with as many single
    environments and the same seeds.

    Args:
        vector: resets in the step that ends an episode, as ``TwoViewPoseVectorEnv`` does.

    Raises:
        InputError: if it resets in the next step instead, or keeps no environments of its own.
    """

    def __init__(self, vector: VectorEnv[Any, Any, Any]) -> None:
        mode = vector.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise InputError(f"autoreset_mode must be {AutoresetMode.SAME_STEP}, got {mode}")
        if not hasattr(vector.unwrapped, "envs"):
            raise InputError(f"{vector.unwrapped} must have its environments in envs")
        environments = iter(vector.unwrapped.envs)
        super().__init__([lambda: next(environments)] * vector.num_envs)
        self._vector = DictInfoToList(vector)

    def reset(self) -> VecEnvObs:
        """Begins an episode in every sub-environment, with the seeds and options that were set.

        Raises:
            InputError: if sub-environments were given different options.
        """
        options = self._options[0]
        if any(own != options for own in self._options[1:]):
            raise InputError("options must be the same for all sub-environments")
        observations, self.reset_infos = self._vector.reset(
            seed=list(self._seeds),  # type: ignore[arg-type]  # a seed each is allowed
            options=options or None,
        )
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_wait(self) -> VecEnvStepReturn:
        """Observations, rewards, ends and infos; the info of an ended episode is its last."""
        observations, rewards, terminated, truncated, infos = self._vector.step(self.actions)
        done = terminated | truncated
        returned = []
        for i, info in enumerate(infos):
            if done[i]:
                last, final = info.pop("final_obs"), info.pop("final_info")
                self.reset_infos[i] = info
                info = {**final, "terminal_observation": last}
            cut = bool(truncated[i] and not terminated[i])
            returned.append({**info, "TimeLimit.truncated": cut})
        return observations, rewards.astype(np.float32), done, returned

    def close(self) -> None:
        """Ends the workers and frees the sub-environments."""
        self._vector.close()
