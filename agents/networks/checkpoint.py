"""The file of a trained agent: tensors and a JSON header in one safetensors file.

Stable-Baselines3's own zip files hold pickled Python objects, and loading one runs whatever code
its author put there. Here the tensors are plain data and the header is JSON, so that a file from a
stranger can at worst be wrong. The header travels in the metadata of the safetensors file: header
and tensors are one file, replaced in one rename. Finished policies are in half precision,
checkpoints in full.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from ...core.errors import InputError
from ...core.files import write_atomically
from ...core.results import commit, versions
from ...pose_estimator.networks.quantization import pack

FORMAT = "two-view-pose agent 2"


@dataclass(frozen=True)
class AgentHeader:
    """What a file of a trained agent says about itself.

    Attributes:
        algo: ``ppo``, ``sac``, ``dqn`` or ``greedy``.
        env: id of the environment it was trained on.
        env_kwargs: the environment's arguments, plain data.
        hyperparameters: the entry of the hyper-parameter file.
        n_envs: environments that ran side by side.
        seed: seed of the training.
        checkpoint_every: environment steps between checkpoints.
        steps: environment steps so far.
        observation_space: see `describe_space`.
        action_space: see `describe_space`.
        counters: the trainer's own counters, empty in a file that holds only a policy.
        aliases: further names of tensors that the file holds once: SB3 names an extractor that
            policy and value share three times.
        versions: package versions at the time of writing.
        commit: commit of the checkout, None for an installed wheel.
        format: name and version of this file format.
    """

    algo: str
    env: str
    env_kwargs: dict[str, Any]
    hyperparameters: dict[str, Any]
    n_envs: int
    seed: int
    checkpoint_every: int
    steps: int
    observation_space: Any
    action_space: Any
    counters: dict[str, float] = field(default_factory=dict)
    aliases: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)
    commit: str | None = field(default_factory=commit)
    format: str = FORMAT


def describe_space(space: spaces.Space) -> Any:
    """Kind, shape and bounds of a Dict, Box or Discrete space as plain data.

    Raises:
        InputError: if it is another kind of space.
    """
    if isinstance(space, spaces.Dict):
        return {key: describe_space(part) for key, part in sorted(space.spaces.items())}
    if isinstance(space, spaces.Discrete):
        return f"Discrete({int(space.n)}, start={int(space.start)})"
    if isinstance(space, spaces.Box):
        low, high = float(space.low.min()), float(space.high.max())
        return f"Box({low:g}, {high:g}, {tuple(space.shape)}, {space.dtype})"
    raise InputError(f"space must be a Dict, a Box or Discrete, got {space}")


def write_agent(
    path: str | os.PathLike[str],
    header: AgentHeader,
    tensors: Mapping[str, torch.Tensor],
    *,
    half: bool = False,
) -> None:
    """Writes an agent file; the path holds either the old file or the whole new one.

    Args:
        path: the file.
        header: what the file says; its aliases are found anew.
        tensors: by name.
        half: whether numbers are stored in half precision, which is enough to act.

    Raises:
        InputError: if the header is not plain data, or numbers do not fit into half precision.
    """
    named: dict[Any, str] = {}
    aliases = {}
    for key, tensor in tensors.items():
        place = (tensor.device, tensor.data_ptr(), tensor.shape, tensor.stride(), tensor.dtype)
        first = named.setdefault(place, key)
        if first != key:
            aliases[key] = first
    try:
        text = json.dumps(asdict(replace(header, aliases=aliases)), sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"agent header must be plain data (text, numbers, lists, mappings): {error}"
        ) from error
    plain = {key: tensors[key].detach().cpu().contiguous().clone() for key in named.values()}
    write_atomically(path, save(pack(plain) if half else plain, metadata={"header": text}))


def read_agent(
    path: str | os.PathLike[str], prefix: str = ""
) -> tuple[AgentHeader, dict[str, torch.Tensor]]:
    """Reads an agent file without executing anything of it.

    Args:
        path: the file.
        prefix: only the tensors whose names begin with it are read.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it is not an agent file, or a damaged one.
    """
    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"agent file {source} does not exist")
    with source.open("rb") as stream:
        start = stream.read(9)
    # A safetensors file begins with eight bytes of length, which may be anything, then its header.
    foreign = start[8:] != b"{"
    if foreign and (start[:4] == b"PK\x03\x04" or start[:1] == b"\x80"):
        raise InputError(
            f"agent file {source} is a {'zip' if start[:1] == b'P' else 'pickle'} file, which can "
            "run code when it is loaded, so it is not loaded; agents are .safetensors files, as "
            "train-agent writes them"
        )
    try:
        with safe_open(source, framework="pt") as file:
            header = _parse_header((file.metadata() or {}).get("header"), source)
            names = {key: key for key in file.keys()} | header.aliases  # noqa: SIM118
            tensors = {
                key: file.get_tensor(name).clone()
                for key, name in names.items()
                if key.startswith(prefix)
            }
    except (SafetensorError, OSError, TypeError) as error:
        raise InputError(f"agent file {source} is not a whole safetensors file: {error}") from error
    for key, tensor in tensors.items():
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise InputError(f"agent file {source} is damaged: {key} has NaN or infinite entries")
    return header, tensors


def _parse_header(text: str | None, source: Path) -> AgentHeader:
    if text is None:
        raise InputError(f"agent file {source} has no header: it is not an agent of train-agent")
    try:
        content = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"agent file {source} has a header that is not JSON: {error}") from error
    found = content.get("format") if isinstance(content, dict) else content
    if found != FORMAT:
        raise InputError(f"agent file {source} must have the format {FORMAT!r}, got {found!r}")
    try:
        header = AgentHeader(**content)
    except TypeError as error:  # something is missing or unknown
        raise InputError(f"agent file {source} has a damaged header: {error}") from error
    kinds = {"algo": str, "env": str, "steps": int, "n_envs": int, "seed": int}
    kinds |= {"env_kwargs": dict, "hyperparameters": dict, "counters": dict, "aliases": dict}
    for key, kind in kinds.items():
        if not isinstance(getattr(header, key), kind):
            raise InputError(
                f"agent file {source} has a damaged header: {key} must be {kind.__name__}, "
                f"got {getattr(header, key)!r}"
            )
    return header


def subset(tensors: Mapping[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    """The tensors whose names begin with ``prefix``, under the rest of their names."""
    return {key[len(prefix) :]: value for key, value in tensors.items() if key.startswith(prefix)}


def check_tensors(
    found: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor], what: str
) -> None:
    """Raises ValueError unless names and shapes agree."""
    missing, unknown = sorted(set(expected) - set(found)), sorted(set(found) - set(expected))
    if missing or unknown:
        raise InputError(f"{what} does not fit: missing {missing[:5]}, unknown {unknown[:5]}")
    for key, tensor in expected.items():
        if tuple(found[key].shape) != tuple(tensor.shape):
            raise InputError(
                f"{what} does not fit: {key} must be of shape {tuple(tensor.shape)}, "
                f"got {tuple(found[key].shape)}"
            )
