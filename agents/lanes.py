"""A Gymnasium vector environment as Stable-Baselines3 wants its environments.

SB3 has vector environments of its own, which run single ones in turn or in a process each, each
with an estimator. ``TwoViewPoseVectorEnv`` asks one estimator for all lanes at once.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers.vector import DictInfoToList
from stable_baselines3.common.vec_env import VecEnv, VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

_Indices = int | Iterable[int] | None


def has_lanes(env_id: str) -> bool:
    """Whether several of an environment are a ``TwoViewPoseVectorEnv``."""
    module, _, name = env_id.rpartition(":")
    if module:
        importlib.import_module(module)  # where the id is registered
    entry = gym.spec(name).vector_entry_point
    return isinstance(entry, str) and entry.startswith("two_view_pose.")


def make_lanes(env_id: str, count: int, arguments: dict[str, Any]) -> VecEnv:
    """Makes ``count`` environments of an id that :func:`has_lanes`, monitored as SB3 does it."""
    return VecMonitor(LanesVecEnv(gym.make_vec(env_id, num_envs=count, **arguments)))


class LanesVecEnv(VecEnv):
    """Lanes of a vector environment, for SB3's trainers.

    Observations, rewards and infos are those of SB3's ``DummyVecEnv`` with as many single
    environments and the same seeds.

    Args:
        lanes: resets in the step that ends an episode, as ``TwoViewPoseVectorEnv`` does.

    Raises:
        ValueError: if it resets in the next step instead, or keeps no environments of its own.
    """

    def __init__(self, lanes: VectorEnv[Any, Any, Any]) -> None:
        mode = lanes.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode must be {AutoresetMode.SAME_STEP}, got {mode}")
        if not hasattr(lanes.unwrapped, "envs"):
            raise ValueError(f"{lanes.unwrapped} must have its environments in envs")
        self._envs: list[gym.Env[Any, Any]] = lanes.unwrapped.envs
        self._lanes = DictInfoToList(lanes)
        self._actions: np.ndarray | None = None
        super().__init__(lanes.num_envs, lanes.single_observation_space, lanes.single_action_space)

    def reset(self) -> VecEnvObs:
        """Begins an episode in every lane, with the seeds and options that were set.

        Raises:
            ValueError: if lanes were given options of their own: they have all the same.
        """
        options = self._options[0]
        if any(own != options for own in self._options[1:]):
            raise ValueError("options must be the same for all lanes")
        observations, self.reset_infos = self._lanes.reset(
            seed=list(self._seeds),  # type: ignore[arg-type]  # a seed each is allowed
            options=options or None,
        )
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Remembers what each lane does next."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Observations, rewards, ends and infos; those of a lane that ended have its last ones."""
        observations, rewards, ended, cut, infos = self._lanes.step(self._actions)
        done = ended | cut
        told = []
        for lane, info in enumerate(infos):
            if done[lane]:
                last, final = info.pop("final_obs"), info.pop("final_info")
                self.reset_infos[lane] = info
                info = {**final, "terminal_observation": last}
            told.append({**info, "TimeLimit.truncated": bool(cut[lane] and not ended[lane])})
        return observations, rewards.astype(np.float32), done, told

    def close(self) -> None:
        """Ends the workers and frees the lanes."""
        self._lanes.close()

    def get_attr(self, attr_name: str, indices: _Indices = None) -> list[Any]:
        """An attribute of each lane."""
        return [getattr(env, attr_name) for env in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: _Indices = None) -> None:
        """Sets an attribute of each lane."""
        for env in self._chosen(indices):
            setattr(env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: _Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Calls a method of each lane."""
        return [
            getattr(env, method_name)(*method_args, **method_kwargs)
            for env in self._chosen(indices)
        ]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: _Indices = None
    ) -> list[bool]:
        """Whether each lane is wrapped: none is."""
        return [isinstance(env, wrapper_class) for env in self._chosen(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """The picture of each lane's episode."""
        return self.env_method("render")

    def _chosen(self, indices: _Indices) -> list[gym.Env[Any, Any]]:
        return [self._envs[lane] for lane in self._get_indices(indices)]
