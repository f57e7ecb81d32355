"""Tuned hyper-parameters: YAML in rl-zoo3's form, checked, turned into SB3 arguments."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import stable_baselines3 as sb3
import torch
import yaml
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import LinearSchedule

from .candidates import CandidateExtractor
from .extractor import ViewExtractor

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": sb3.PPO, "sac": sb3.SAC, "dqn": sb3.DQN}

GREEDY = "greedy"
"""The algorithm that is no reinforcement learning: a network predicts every candidate's error."""

SHIPPED = Path(__file__).with_name("hyperparameters.yml")

ACTIVATIONS: dict[str, type[torch.nn.Module]] = {
    "tanh": torch.nn.Tanh,
    "relu": torch.nn.ReLU,
    "elu": torch.nn.ELU,
    "silu": torch.nn.SiLU,
}

EXTRACTORS: dict[str, type[BaseFeaturesExtractor]] = {
    "ViewExtractor": ViewExtractor,
    "CandidateExtractor": CandidateExtractor,
}
"""Feature extractors that plain data can name."""


@dataclass(frozen=True)
class GreedyHyperparameters:
    """How the networks of ``greedy-predicted`` are trained.

    Attributes:
        epochs: times that every scene is seen.
        batch_size: scenes in a batch.
        learning_rate: falls to 0 along half a cosine.
        weight_decay: of AdamW.
        features_dim, width, dropout: of each network, see :class:`~.predictor.ErrorPredictor`.
        networks: how many networks answer together.
        sure: probability of a right pose from which on the agent stops, where it may.
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


POLICY_KWARGS = frozenset(
    {
        "activation_fn",
        "features_extractor_class",
        "features_extractor_kwargs",
        "log_std_init",
        "n_critics",
        "net_arch",
        "normalize_images",
        "optimizer_kwargs",
        "ortho_init",
        "share_features_extractor",
    }
)
"""The policy arguments that plain data can express; a class would need code to name it."""

OURS = frozenset({"n_timesteps", "n_envs", "policy", "policy_kwargs"})
NOT_PLAIN = frozenset(
    {"self", "env", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model"}
)


def load_hyperparameters(algo: str, env_id: str, path: Path | None = None) -> dict[str, Any]:
    """Reads the hyper-parameters of an algorithm on an environment.

    Args:
        algo: ``ppo``, ``sac`` or ``dqn``.
        env_id: the environment's id, without the name of a module before a colon.
        path: a YAML file of the same form as the shipped one, or None for the shipped one.

    Raises:
        ValueError: if the file is malformed, has no such entry or has an unknown name in it.
    """
    source = SHIPPED if path is None else path
    try:
        document = yaml.safe_load(source.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ValueError(f"hyper-parameter file {source} cannot be read: {error}") from error
    table = document.get(algo) if isinstance(document, dict) else None
    entry = table.get(env_id) if isinstance(table, dict) else None
    if not isinstance(entry, dict):
        known = sorted(table) if isinstance(table, dict) else []
        raise ValueError(
            f"hyper-parameter file {source} has no entry {algo}: {env_id} "
            f"(for {algo} it has {', '.join(known) or 'none'})"
        )
    check_hyperparameters(algo, entry)
    return entry


def check_hyperparameters(algo: str, entry: Mapping[str, Any]) -> None:
    """Raises ValueError if a name in ``entry`` is not an argument of the algorithm."""
    if algo not in (*ALGORITHMS, GREEDY):
        raise ValueError(f"algo must be one of {', '.join([*ALGORITHMS, GREEDY])}, got {algo!r}")
    if algo == GREEDY:
        allowed = {item.name for item in fields(GreedyHyperparameters)}
    else:
        allowed = (set(inspect.signature(ALGORITHMS[algo]).parameters) | OURS) - NOT_PLAIN
    unknown = sorted(set(entry) - allowed)
    if unknown:
        raise ValueError(
            f"unknown hyper-parameters of {algo}: {', '.join(map(str, unknown))} "
            f"(allowed: {', '.join(sorted(allowed))})"
        )
    if entry.get("policy", "MultiInputPolicy") != "MultiInputPolicy":
        raise ValueError(f"policy must be MultiInputPolicy, got {entry['policy']!r}")


def algorithm_kwargs(entry: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of the SB3 algorithm that ``entry`` describes, without policy and env."""
    kwargs = {key: _schedule(value) for key, value in entry.items() if key not in OURS}
    if isinstance(kwargs.get("train_freq"), list):
        kwargs["train_freq"] = tuple(kwargs["train_freq"])
    kwargs["policy_kwargs"] = policy_kwargs(entry)
    return kwargs


def policy_kwargs(entry: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of the SB3 policy that ``entry`` describes.

    Raises:
        ValueError: if a name or a value is not allowed.
    """
    given = entry.get("policy_kwargs", {})
    if not isinstance(given, Mapping):
        raise ValueError(f"policy_kwargs must be a mapping, got {given!r}")
    unknown = sorted(set(given) - POLICY_KWARGS)
    if unknown:
        raise ValueError(
            f"unknown policy_kwargs: {', '.join(map(str, unknown))} "
            f"(allowed: {', '.join(sorted(POLICY_KWARGS))})"
        )
    kwargs = dict(given)
    named: dict[str, Mapping[str, Any]] = {
        "activation_fn": ACTIVATIONS,
        "features_extractor_class": EXTRACTORS,
    }
    for name, choices in named.items():
        if name not in kwargs:
            continue
        if kwargs[name] not in choices:
            raise ValueError(f"{name} must be one of {', '.join(choices)}, got {kwargs[name]!r}")
        kwargs[name] = choices[kwargs[name]]
    return kwargs


def _schedule(value: Any) -> Any:
    """rl-zoo3's ``lin_x``: from x at the start of training to 0 at its end."""
    if isinstance(value, str) and value.startswith("lin_"):
        try:
            start = float(value.removeprefix("lin_"))
        except ValueError as error:
            raise ValueError(f"a linear schedule is written lin_<number>, got {value!r}") from error
        return LinearSchedule(start, 0.0, 1.0)
    return value
