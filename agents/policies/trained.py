"""Trained agents, rebuilt from plain data; loading a file executes nothing."""

import os
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.vec_env import VecTransposeImage

from ...core.device import resolve_device
from ...core.errors import InputError
from ..networks.algorithms import (
    ALGORITHMS,
    GREEDY,
    POLICY_CLASS,
    check_hyperparameters,
    policy_kwargs,
)
from ..networks.checkpoint import AgentHeader, check_tensors, describe_space, read_agent, subset
from .baselines import Policy
from .greedy import GreedyPolicy, load_agent
from .view_sphere import Action


class TrainedPolicy(Policy):
    """Acts deterministically with a policy that SB3 trained."""

    def __init__(self, policy: BasePolicy) -> None:
        self._policy = policy

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Returns the action for one observation of the environment (not batched)."""
        action, _ = self._policy.predict(dict(observation), deterministic=True)
        return int(action) if isinstance(self._policy.action_space, spaces.Discrete) else action


def load_policy(path: str | os.PathLike[str], env: gym.Env, device: str = "auto") -> Policy:
    """Loads a ``policy.safetensors`` or ``checkpoint.safetensors`` of ``train-agent``.

    Args:
        path: the file.
        env: the environment in which it will act.
        device: where its networks run: ``auto`` (a GPU if there is one), ``cpu``, ``cuda``,
            ``cuda:N`` or ``mps``.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it is not an agent file, is corrupted, or was trained with other spaces than
            those of ``env``, or there is no such device.
    """
    torch_device = resolve_device(device)
    header, tensors = read_agent(path, prefix="policy/")
    weights, source = subset(tensors, "policy/"), f"agent file {path}"
    try:
        check_hyperparameters(header.algo, header.hyperparameters)
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    _check_spaces(header, env, path)
    space = channels_first(env)
    if header.algo == GREEDY:
        known = spaces.Dict({key: space[key] for key in header.observation_space})
        return GreedyPolicy(load_agent(header, known, weights, source, torch_device), header, env)
    policy = _build(header, space, env.action_space, source)
    check_tensors(weights, policy.state_dict(), source)
    policy.load_state_dict(weights)
    return TrainedPolicy(policy.to(torch_device))


def channels_first(env: gym.Env) -> spaces.Dict:
    """The observation space with channels-first images; raises InputError if it is not a Dict."""
    space = env.observation_space
    if not isinstance(space, spaces.Dict):
        raise InputError(f"the environment's observation must be a Dict, got {space}")
    parts = dict(space.spaces)
    for key, part in parts.items():
        if isinstance(part, spaces.Box) and is_image_space(part):
            parts[key] = VecTransposeImage.transpose_space(part)
    return spaces.Dict(parts)


def _build(
    header: AgentHeader, space: spaces.Dict, action_space: spaces.Space, source: str
) -> BasePolicy:
    policy_class: Any = ALGORITHMS[header.algo].policy_aliases[POLICY_CLASS]
    with torch.random.fork_rng(devices=[]):  # random initial weights leave the caller's RNG as is
        try:
            kwargs = policy_kwargs(header.hyperparameters)
            policy = policy_class(space, action_space, lambda _: 0.0, **kwargs)
        except (MemoryError, torch.OutOfMemoryError):
            raise
        except Exception as error:  # of SB3 and torch, for values that they do not expect
            raise InputError(
                f"{source}: policy_kwargs {header.hyperparameters.get('policy_kwargs')!s:.200} do "
                f"not make a policy of {header.algo}: {error}"
            ) from error
    policy.set_training_mode(False)
    return policy


def _check_spaces(header: AgentHeader, env: gym.Env, path: str | os.PathLike[str]) -> None:
    greedy = header.algo == GREEDY  # takes any views, ignores further observations
    for name in ("observation", "action"):
        trained = getattr(header, f"{name}_space")
        found = describe_space(getattr(env, f"{name}_space"))
        if greedy and isinstance(trained, dict) and isinstance(found, dict):
            found = {key: part for key, part in found.items() if key in trained}
        if found != trained and not (greedy and name == "action"):
            here = env.spec.id if env.spec else type(env.unwrapped).__name__
            raise InputError(
                f"agent file {path} was trained on {header.env:.80} with the {name} space "
                f"{trained!s:.300}; {here} has {found}"
            )
