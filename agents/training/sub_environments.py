"""Adapts a Gymnasium vector environment to Stable-Baselines3's ``VecEnv``.

SB3's own vector environments run sub-environments sequentially or in one process each, each with
its own estimator. ``TwoViewPoseVectorEnv`` batches all of them in one estimator.
"""

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
    """Whether ``gymnasium.make_vec`` gives a ``TwoViewPoseVectorEnv`` for an id."""
    module, _, name = env_id.rpartition(":")
    if module:
        importlib.import_module(module)  # where the id is registered
    entry = gym.spec(name).vector_entry_point
    return isinstance(entry, str) and entry.startswith("two_view_pose.")


def make_sub_environments(env_id: str, n_envs: int, env_kwargs: dict[str, Any]) -> VecEnv:
    """Makes a monitored ``VecEnv`` of ``n_envs`` sub-environments that share one estimator.

    :func:`has_vector_env` must hold for ``env_id``.
    """
    vector = gym.make_vec(env_id, num_envs=n_envs, **env_kwargs)
    return VecMonitor(SharedEstimatorVecEnv(vector))


class SharedEstimatorVecEnv(DummyVecEnv):
    """A Gymnasium vector environment as an SB3 ``VecEnv``.

    Observations, rewards and infos equal those of SB3's ``DummyVecEnv`` with the same seeds.

    Args:
        vector: with autoreset mode SAME_STEP and an attribute ``envs``.

    Raises:
        InputError: if it has another autoreset mode or no ``envs``.
    """

    def __init__(self, vector: VectorEnv[Any, Any, Any]) -> None:
        mode = vector.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise InputError(f"autoreset_mode must be {AutoresetMode.SAME_STEP}, got {mode}")
        if not hasattr(vector.unwrapped, "envs"):
            raise InputError(f"{vector.unwrapped} must have the attribute envs")
        envs = iter(vector.unwrapped.envs)
        super().__init__([lambda: next(envs)] * vector.num_envs)
        self._vector = DictInfoToList(vector)

    def reset(self) -> VecEnvObs:
        """Resets every sub-environment; raises InputError if their options differ."""
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
        """Returns observations, rewards, dones and infos; a done episode has its final info."""
        observations, rewards, terminated, truncated, infos = self._vector.step(self.actions)
        done = terminated | truncated
        returned = []
        for i, info in enumerate(infos):
            if done[i]:
                last, final = info.pop("final_obs"), info.pop("final_info")
                self.reset_infos[i] = info
                info = {**final, "terminal_observation": last}
            time_limit = bool(truncated[i] and not terminated[i])
            returned.append({**info, "TimeLimit.truncated": time_limit})
        return observations, rewards.astype(np.float32), done, returned

    def close(self) -> None:
        """Stops the workers and closes the sub-environments."""
        self._vector.close()
