"""Tuned hyper-parameters: reads YAML in rl-zoo3's format and converts it to SB3 arguments."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from stable_baselines3.common.utils import LinearSchedule

from ...core.errors import InputError
from ...core.text_files import read_text
from ..networks.algorithms import RESERVED_KEYS, check_hyperparameters, policy_kwargs

SHIPPED = Path(__file__).with_name("hyperparameters.yml")


def load_hyperparameters(algo: str, env_id: str, path: Path | None = None) -> dict[str, Any]:
    """Reads the hyper-parameters of an algorithm on an environment.

    Args:
        algo: ``ppo``, ``sac``, ``dqn`` or ``greedy``.
        env_id: the environment's id, without a module name before a colon.
        path: a YAML file of the same format; None for the shipped one.

    Raises:
        InputError: if the file is malformed, or has no such entry or an unknown name.
    """
    source = SHIPPED if path is None else path
    try:
        document = yaml.safe_load(read_text(source))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise InputError(f"hyper-parameter file {source} cannot be read: {error}") from error
    table = document.get(algo) if isinstance(document, dict) else None
    entries = table if isinstance(table, dict) else {}
    entry = entries.get(env_id)
    if not isinstance(entry, dict):
        names = ", ".join(sorted(entries)) or "none"
        raise InputError(f"{source} has no entry {algo}: {env_id} (for {algo} it has {names})")
    try:
        check_hyperparameters(algo, entry)
        algorithm_kwargs(entry)
    except InputError as error:
        raise InputError(f"{source}, {algo}: {env_id}: {error}") from error
    return entry


def algorithm_kwargs(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Converts an entry to keyword arguments of the SB3 algorithm, without policy and env."""
    kwargs = {key: _schedule(value) for key, value in entry.items() if key not in RESERVED_KEYS}
    if isinstance(kwargs.get("train_freq"), list):
        kwargs["train_freq"] = tuple(kwargs["train_freq"])
    return kwargs | {"policy_kwargs": policy_kwargs(entry)}


def _schedule(value: Any) -> Any:
    """Converts rl-zoo3's ``lin_x``, linear from x at the start of training to 0 at its end."""
    if not (isinstance(value, str) and value.startswith("lin_")):
        return value
    try:
        return LinearSchedule(float(value.removeprefix("lin_")), 0.0, 1.0)
    except ValueError as error:
        raise InputError(f"a linear schedule must be lin_<number>, got {value!r}") from error
