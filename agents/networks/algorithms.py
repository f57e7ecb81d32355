"""The algorithms that train agents, and which of their arguments plain data can express."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import stable_baselines3 as sb3
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from ...core.errors import InputError
from .candidates import CandidateExtractor

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": sb3.PPO, "sac": sb3.SAC, "dqn": sb3.DQN}

POLICY_CLASS = "MultiInputPolicy"
"""SB3's name for policies of Dict observations."""

GREEDY = "greedy"
"""The algorithm that is no reinforcement learning: a network predicts every candidate's error."""

NAMED_CLASSES: dict[str, dict[str, type[nn.Module]]] = {
    "activation_fn": {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU, "silu": nn.SiLU},
    "features_extractor_class": {"CandidateExtractor": CandidateExtractor},
}
"""Policy arguments that are classes, with the names by which plain data may choose them."""

RESERVED_KEYS = frozenset({"n_timesteps", "n_envs", "policy", "policy_kwargs"})
"""Hyper-parameters that are not handed to the algorithm as they are."""

NON_SERIALIZABLE = frozenset(
    {
        *("env", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model"),
        *("observation_space", "action_space", "lr_schedule", "optimizer_class"),
    }
)
"""SB3's arguments that are set by the training itself, or that plain data cannot express."""


@dataclass(frozen=True)
class GreedyHyperparameters:
    """How the networks of ``greedy`` are trained.

    Attributes:
        epochs: times that every scene is seen.
        batch_size: scenes in a batch.
        learning_rate: falls to 0 along half a cosine.
        weight_decay: of AdamW.
        features_dim, width, dropout: of each network, see :class:`~.predictor.ErrorPredictor`.
        networks: how many networks answer together.
        sure: stop threshold, the probability of a right pose from which on the agent stops where
            it may. The agents that ship name it so.
    """

    epochs: int = 60
    batch_size: int = 32
    learning_rate: float = 1e-3
    weight_decay: float = 1e-2
    features_dim: int = 128
    width: int = 12
    dropout: float = 0.3
    networks: int = 4
    sure: float = 0.95


def check_hyperparameters(algo: str, entry: Mapping[str, Any]) -> None:
    """Checks the names of an algorithm's hyper-parameters.

    Raises:
        InputError: if there is no such algorithm, or a name is no argument of it or of its policy.
    """
    if algo == GREEDY:
        _check_names("hyper-parameters of greedy", entry, GreedyHyperparameters)
        return
    if algo not in ALGORITHMS:
        raise InputError(f"algo must be one of {', '.join([*ALGORITHMS, GREEDY])}, got {algo!r}")
    own = {key: value for key, value in entry.items() if key not in RESERVED_KEYS}
    _check_names(f"hyper-parameters of {algo}", own, ALGORITHMS[algo])
    if entry.get("policy", POLICY_CLASS) != POLICY_CLASS:
        raise InputError(f"policy must be {POLICY_CLASS}, got {entry['policy']!r}")
    given = entry.get("policy_kwargs", {})
    if not isinstance(given, Mapping):
        raise InputError(f"policy_kwargs must be a mapping, got {given!r}")
    _check_names("policy_kwargs", given, ALGORITHMS[algo].policy_aliases[POLICY_CLASS])


def _check_names(what: str, given: Mapping[str, Any], function: Any) -> None:
    allowed = inspect.signature(function).parameters.keys() - NON_SERIALIZABLE
    unknown = sorted(map(str, given.keys() - allowed))
    if unknown:
        raise InputError(
            f"unknown {what}: {', '.join(unknown)} (allowed: {', '.join(sorted(allowed))})"
        )


def policy_kwargs(entry: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of the SB3 policy that checked hyper-parameters describe.

    Raises:
        InputError: if a class is named that plain data cannot choose.
    """
    kwargs = dict(entry.get("policy_kwargs", {}))
    for key, classes in NAMED_CLASSES.items():
        if key in kwargs:
            if kwargs[key] not in classes:
                raise InputError(f"{key} must be one of {', '.join(classes)}, got {kwargs[key]!r}")
            kwargs[key] = classes[kwargs[key]]
    return kwargs
