"""Agent files: tensors, and a JSON header in the metadata, in one safetensors file.

SB3's own zip files hold pickled Python objects, so loading one can run arbitrary code. Here
everything is plain data, safe to load from an untrusted source. Finished policies are in half
precision, checkpoints in full.
"""

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
from ...core.validation import is_number
from ...pose_estimator.networks.quantization import pack

FORMAT = "two-view-pose agent 2"


@dataclass(frozen=True)
class AgentHeader:
    """Metadata of an agent file.

    Attributes:
        algo: ``ppo``, ``sac``, ``dqn`` or ``greedy``.
        env: id of the training environment.
        env_kwargs: its arguments, plain data.
        hyperparameters: the entry of the hyper-parameter file.
        n_envs: number of parallel environments.
        seed: seed of the training.
        checkpoint_every: environment steps between checkpoints.
        steps: environment steps so far.
        observation_space, action_space: see `describe_space`.
        counters: the trainer's counters, empty in a file that holds only a policy.
        aliases: further names of shared tensors: SB3 names an extractor that policy and value share
            three times.
        versions: package versions at the time of writing.
        commit: commit of the checkout, None for an installed wheel.
        format: name and version of the file format.
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
    """Describes a Dict, Box or Discrete space as plain data; raises InputError for others."""
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
    """Writes an agent file atomically.

    Args:
        path: the file.
        header: its metadata; the aliases are computed from the tensors.
        tensors: by name.
        half: store in half precision, which is enough to act.

    Raises:
        InputError: if the header is not plain data, or numbers do not fit into half precision.
    """
    named: dict[Any, str] = {}
    aliases = {}
    for key, tensor in tensors.items():
        storage = (tensor.device, tensor.data_ptr(), tensor.shape, tensor.stride(), tensor.dtype)
        first = named.setdefault(storage, key)
        if first != key:
            aliases[key] = first
    try:
        text = json.dumps(asdict(replace(header, aliases=aliases)), sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"agent header must be JSON-serializable: {error}") from error
    plain = {key: tensors[key].detach().cpu().contiguous().clone() for key in named.values()}
    write_atomically(path, save(pack(plain) if half else plain, metadata={"header": text}))


def read_agent(
    path: str | os.PathLike[str], prefix: str = ""
) -> tuple[AgentHeader, dict[str, torch.Tensor]]:
    """Reads an agent file without executing anything.

    Args:
        path: the file.
        prefix: reads only tensors whose names start with it.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it is not an agent file, or is corrupted.
    """
    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"agent file {source} does not exist")
    with source.open("rb") as stream:
        start = stream.read(9)
    # A safetensors file starts with eight bytes of length, which may be anything, then JSON.
    if start[8:] != b"{" and start.startswith((b"PK\x03\x04", b"\x80")):
        raise InputError(
            f"{source} is a zip or pickle file, which can run code when loaded, so it is not "
            "loaded; train-agent writes .safetensors files"
        )
    try:
        with safe_open(source, framework="pt") as file:
            header = _parse_header((file.metadata() or {}).get("header"), source)
            names = {key: key for key in file.keys()} | header.aliases  # noqa: SIM118
            names = {key: name for key, name in names.items() if key.startswith(prefix)}
            tensors = {key: file.get_tensor(name).clone() for key, name in names.items()}
    except (SafetensorError, OSError, TypeError, UnicodeError) as error:
        raise InputError(f"{source} is not a complete safetensors file: {error}") from error
    for key, tensor in tensors.items():
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise InputError(f"agent file {source} is corrupted: {key} has NaN or infinite entries")
    return header, tensors


def _parse_header(text: str | None, source: Path) -> AgentHeader:
    if text is None:
        raise InputError(f"agent file {source} has no header: train-agent did not write it")
    try:
        content = json.loads(text)
        found = content.get("format") if isinstance(content, dict) else content
        if found != FORMAT:
            raise InputError(
                f"agent file {source} must have the format {FORMAT!r}, got {found!r:.80}"
            )
        header = AgentHeader(**content)
        types = {"algo": str, "env": str, "steps": int, "n_envs": int, "seed": int}
        types |= {"env_kwargs": dict, "hyperparameters": dict, "counters": dict, "aliases": dict}
        for key, kind in types.items():
            value = getattr(header, key)
            if not isinstance(value, kind) or isinstance(value, bool):
                raise TypeError(f"{key} must be {kind.__name__}, got {value!r:.80}")
        for key, value in header.counters.items():
            if not is_number(value):
                raise TypeError(f"the counter {key} must be a number, got {value!r:.80}")
        if min(header.steps, header.counters.get("num_timesteps", 0)) < 0:
            raise TypeError(f"steps must be >= 0, got {header.steps} and {header.counters}")
    except InputError:
        raise
    except (RecursionError, TypeError, ValueError) as error:
        raise InputError(f"agent file {source} has a corrupted header: {error}") from error
    return header


def subset(tensors: Mapping[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    """The tensors whose names start with ``prefix``, with the prefix removed."""
    return {key[len(prefix) :]: value for key, value in tensors.items() if key.startswith(prefix)}


def check_tensors(
    found: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor], source: str
) -> None:
    """Raises InputError unless names and shapes agree."""
    missing = sorted(expected.keys() - found.keys())
    unknown = sorted(found.keys() - expected.keys())
    if missing or unknown:
        raise InputError(f"{source} does not fit: missing {missing[:5]}, unknown {unknown[:5]}")
    for key, tensor in expected.items():
        shape, wanted = tuple(found[key].shape), tuple(tensor.shape)
        if shape != wanted:
            raise InputError(f"{source} does not fit: {key} must be of shape {wanted}, got {shape}")
