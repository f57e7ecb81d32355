"""Checkpoints of a training stage: one safetensors file, replaced atomically."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from safetensors import safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn

from ...core.errors import InputError
from ...core.files import write_atomically

_MODEL = "model."


def save_checkpoint(
    path: Path, module: nn.Module, state: Mapping[str, Tensor], numbers: Mapping[str, int]
) -> None:
    """Writes a checkpoint in place of the one that is there.

    Args:
        path: ``NAME.safetensors``.
        module: whose parameters and buffers are kept.
        state: further tensors by name, of the optimizer for example.
        numbers: kept with them, ``step`` among them.
    """
    tensors = {f"{_MODEL}{name}": tensor for name, tensor in module.state_dict().items()}
    contiguous = {name: tensor.contiguous() for name, tensor in {**tensors, **state}.items()}
    write_atomically(path, save(contiguous, {name: str(n) for name, n in numbers.items()}))


def load_checkpoint(module: nn.Module, path: Path) -> dict[str, Tensor]:
    """Restores a module from a checkpoint; returns the further tensors that the file holds.

    Raises:
        InputError: if it is of networks of another shape.
    """
    tensors = load_file(path)
    names = [name for name in tensors if name.startswith(_MODEL)]
    model = {name.removeprefix(_MODEL): tensors.pop(name) for name in names}
    try:
        module.load_state_dict(model)
    except RuntimeError as error:
        raise InputError(
            f"checkpoint {path} is of networks of another shape; give another --out, or delete it"
        ) from error
    return tensors


def read_numbers(path: Path) -> dict[str, int]:
    """The numbers of a checkpoint alone."""
    with safe_open(path, framework="pt") as file:
        return {name: int(number) for name, number in file.metadata().items()}
