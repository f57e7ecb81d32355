"""Training algorithms, and checks of their hyper-parameters given as plain data."""

import inspect
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import stable_baselines3 as sb3
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from ...core.errors import InputError
from ...core.validation import require_within
from .candidates import CandidateExtractor

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": sb3.PPO, "sac": sb3.SAC, "dqn": sb3.DQN}

POLICY_CLASS = "MultiInputPolicy"
"""SB3's policy class for Dict observations."""

GREEDY = "greedy"
"""Supervised error regression instead of reinforcement learning."""

NAMED_CLASSES: dict[str, dict[str, type[nn.Module]]] = {
    "activation_fn": {"tanh": nn.Tanh, "relu": nn.ReLU, "elu": nn.ELU, "silu": nn.SiLU},
    "features_extractor_class": {"CandidateExtractor": CandidateExtractor},
}
"""Policy arguments that are classes, and the names that select them in plain data."""

MAX_SIZE = 8192
"""Of a layer: a damaged file must not fill the memory."""

MAX_DEPTH = 5
"""Of lists and mappings in each other among the policy's arguments."""

RESERVED_KEYS = frozenset({"n_timesteps", "n_envs", "policy", "policy_kwargs"})
"""Hyper-parameters that are not passed to the algorithm unchanged."""

NON_SERIALIZABLE = frozenset(
    {
        *("env", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model"),
        *("observation_space", "action_space", "lr_schedule", "optimizer_class"),
    }
)
"""Arguments of SB3 that the training sets itself, or that plain data cannot express."""


@dataclass(frozen=True)
class GreedyHyperparameters:
    """Hyper-parameters of ``greedy``.

    Attributes:
        epochs: passes over all scenes.
        batch_size: scenes in a batch.
        learning_rate: initial value, annealed to 0 by a cosine schedule.
        weight_decay: of AdamW.
        features_dim, width, dropout: of each network, see :class:`~.predictor.ErrorPredictor`.
        networks: number of networks in the ensemble.
        sure: stop threshold: the agent stops at this probability of a correct pose. Files of agents
            use this name.
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

    def __post_init__(self) -> None:
        counts = ("epochs", "batch_size", "features_dim", "width", "networks")
        for name in counts:
            if type(getattr(self, name)) is not int:
                raise InputError(f"{name} must be an integer, got {getattr(self, name)!r:.80}")
        require_within(self, 1, 10_000, *counts)
        require_within(self, 0, 1, "dropout", "sure")
        require_within(self, 0, math.inf, "learning_rate", "weight_decay")


def check_hyperparameters(algo: str, entry: Mapping[str, Any]) -> None:
    """Raises InputError if the algorithm, or an argument of it or of its policy, is unknown."""
    if algo == GREEDY:
        _check_names("hyper-parameters of greedy", entry, GreedyHyperparameters)
        GreedyHyperparameters(**entry)
        return
    if algo not in ALGORITHMS:
        raise InputError(f"algo must be one of {', '.join([*ALGORITHMS, GREEDY])}, got {algo!r}")
    _check_names(f"hyper-parameters of {algo}", entry.keys() - RESERVED_KEYS, ALGORITHMS[algo])
    if entry.get("policy", POLICY_CLASS) != POLICY_CLASS:
        raise InputError(f"policy must be {POLICY_CLASS}, got {entry['policy']!r}")
    kwargs = entry.get("policy_kwargs", {})
    if not isinstance(kwargs, Mapping):
        raise InputError(f"policy_kwargs must be a mapping, got {kwargs!r}")
    _check_names("policy_kwargs", kwargs, ALGORITHMS[algo].policy_aliases[POLICY_CLASS])
    _check_sizes(kwargs)


def _check_sizes(value: Any, depth: int = 0) -> None:
    """Raises InputError where a number is too large for the size of a layer."""
    if depth > MAX_DEPTH:  # a file may name a list within itself
        raise InputError(f"policy_kwargs are nested more than {MAX_DEPTH} times")
    if isinstance(value, Mapping | list | tuple):
        for part in value.values() if isinstance(value, Mapping) else value:
            _check_sizes(part, depth + 1)
    elif isinstance(value, int) and value > MAX_SIZE:
        raise InputError(f"numbers in policy_kwargs must be <= {MAX_SIZE}, got {value!s:.80}")


def _check_names(what: str, names: Iterable[str], function: Any) -> None:
    allowed = inspect.signature(function).parameters.keys() - NON_SERIALIZABLE
    unknown = sorted(str(name) for name in names if name not in allowed)
    if unknown:
        raise InputError(
            f"unknown {what}: {', '.join(unknown)} (allowed: {', '.join(sorted(allowed))})"
        )


def policy_kwargs(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Converts ``policy_kwargs`` to SB3's; raises InputError if a class is not a named one."""
    kwargs = dict(entry.get("policy_kwargs", {}))
    for key, classes in NAMED_CLASSES.items():
        if key in kwargs:
            if kwargs[key] not in classes:
                raise InputError(f"{key} must be one of {', '.join(classes)}, got {kwargs[key]!r}")
            kwargs[key] = classes[kwargs[key]]
    return kwargs
