"""The table of policies, by name or by file."""

import os
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym

from ... import assets
from ...core.errors import InputError
from .baselines import AbovePolicy, FixedPolicy, MaxBaselinePolicy, Policy, RandomPolicy, StayPolicy
from .oracle import OraclePolicy
from .uncertainty import UncertaintyPolicy

BASELINES: dict[str, Callable[[gym.Env], Policy]] = {
    "stay": StayPolicy,
    "random": RandomPolicy,
    "fixed": FixedPolicy,
    "above": AbovePolicy,
    "max-baseline": MaxBaselinePolicy,
    "uncertainty": UncertaintyPolicy,
    "oracle": OraclePolicy,
}

SHIPPED = Path(assets.__file__).parent / "agents"


def shipped_agents() -> dict[str, Path]:
    """Files of the trained agents that ship, by name."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.safetensors"))}


def agent_file(name_or_path: str | os.PathLike[str]) -> Path | None:
    """The file of a trained policy, None for a baseline; raises InputError if it is neither."""
    name, shipped = os.fspath(name_or_path), shipped_agents()
    if name in BASELINES:
        return None
    if name in shipped:
        return shipped[name]
    if not os.path.isfile(name):
        names = ", ".join([*BASELINES, *shipped])
        raise InputError(f"policy must be one of {names}, or a file of train-agent; got {name!r}")
    return Path(name)


def make_policy(name_or_path: str | os.PathLike[str], env: gym.Env, device: str = "auto") -> Policy:
    """Makes a policy that acts in ``env``.

    Args:
        name_or_path: a baseline, a trained agent that ships, or a file of ``train-agent``.
        env: the environment; most baselines query it during the episode.
        device: where the networks of a trained one run, see ``load_policy``.

    Raises:
        InputError: if it is neither, or as ``load_policy``.
    """
    path = agent_file(name_or_path)
    if path is None:
        return BASELINES[os.fspath(name_or_path)](env)
    from .trained import load_policy

    return load_policy(path, env, device)
