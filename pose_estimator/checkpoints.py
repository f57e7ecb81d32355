"""Checkpoints on disk: one safetensors file, or several of a limited size with an index.

In parts, ``NAME.safetensors.index.json`` says which file holds which tensor, in Hugging Face's
form. It is written last, and parts have names that no other checkpoint's have: whoever is killed in
between leaves the old checkpoint whole.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping
from pathlib import Path

from safetensors import safe_open
from safetensors.torch import load_file, save
from torch import Tensor

from .results import write_atomically

_HEADER = 256
"""Bytes that a tensor may take in a file's header, its name left out."""


def save_checkpoint(
    path: Path, tensors: Mapping[str, Tensor], numbers: Mapping[str, int], part_mib: int = 0
) -> None:
    """Writes a checkpoint in place of the one that is there.

    Args:
        path: ``NAME.safetensors``; parts and their index stand beside it.
        tensors: by name.
        numbers: kept with them, ``step`` among them.
        part_mib: largest size of a file; what fits into one is not cut. 0: no limit.

    Raises:
        ValueError: if a tensor alone is larger than a part.
    """
    old = {*_parts(path), *(file for file in (path, _index(path)) if file.is_file())}
    metadata = {name: str(number) for name, number in numbers.items()}
    parts = _divide(tensors, part_mib * 2**20) if part_mib else [list(tensors)]
    if len(parts) == 1:
        write_atomically(path, save(dict(tensors), metadata))
        new = {path}
    else:
        token = secrets.token_hex(4)  # another run may have reached the same step
        where: dict[str, str] = {}
        for number, names in enumerate(parts, 1):
            part = f"{path.stem}-{numbers['step']}-{token}-{number:05}-of-{len(parts):05}"
            content = save({name: tensors[name] for name in names}, metadata)
            write_atomically(path.with_name(f"{part}.safetensors"), content)
            where |= dict.fromkeys(names, f"{part}.safetensors")
        index = {"metadata": dict(numbers), "weight_map": where}
        write_atomically(_index(path), json.dumps(index, indent=1).encode())
        new = {_index(path), *(path.with_name(part) for part in where.values())}
    for file in old - new:
        file.unlink()


def load_checkpoint(path: Path) -> tuple[dict[str, Tensor], dict[str, int]]:
    """The tensors and the numbers of a checkpoint of either form.

    Raises:
        FileNotFoundError: if there is none.
    """
    if not _is_in_parts(path):
        return load_file(path), read_numbers(path)
    tensors: dict[str, Tensor] = {}
    for name in sorted(set(json.loads(_index(path).read_text())["weight_map"].values())):
        tensors |= load_file(path.with_name(name))
    return tensors, read_numbers(path)


def read_numbers(path: Path) -> dict[str, int]:
    """The numbers of a checkpoint alone."""
    if _is_in_parts(path):
        metadata = json.loads(_index(path).read_text())["metadata"]
    else:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
    return {name: int(number) for name, number in metadata.items()}


def has_checkpoint(path: Path) -> bool:
    """Whether there is a checkpoint, of either form."""
    return path.is_file() or _index(path).is_file()


def _index(path: Path) -> Path:
    return path.with_name(f"{path.name}.index.json")


def _parts(path: Path) -> list[Path]:
    return list(path.parent.glob(f"{path.stem}-*-of-*.safetensors"))


def _is_in_parts(path: Path) -> bool:
    """Which form is the newer one; both are there if a run was killed between writing and removing
    them."""
    index = _index(path)
    if not (index.is_file() and path.is_file()):
        return index.is_file()
    return index.stat().st_mtime_ns >= path.stat().st_mtime_ns


def _divide(tensors: Mapping[str, Tensor], limit: int) -> list[list[str]]:
    """Names of the tensors of each part, in order."""
    parts: list[list[str]] = []
    room = -1
    for name, tensor in tensors.items():
        size = tensor.nbytes + len(name.encode()) + _HEADER
        if size + _HEADER > limit:
            raise ValueError(
                f"a checkpoint's parts of {limit / 2**20:g} MiB are too small for {name}, which "
                f"has {tensor.nbytes / 2**20:.1f} MiB: raise --max-part-mib"
            )
        if size > room:
            parts.append([])
            room = limit - _HEADER  # of the file's own numbers
        parts[-1].append(name)
        room -= size
    return parts
