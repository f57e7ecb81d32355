"""Checkpoints of a training stage: one safetensors file, replaced atomically."""

from collections.abc import Mapping
from pathlib import Path

from safetensors import safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn

from ...core.errors import InputError
from ...core.files import write_atomically

_MODEL = "model."


def save_checkpoint(
    path: Path, module: nn.Module, state: Mapping[str, Tensor], counters: Mapping[str, int]
) -> None:
    """Writes a checkpoint, replacing an older one.

    Args:
        path: ``NAME.safetensors``.
        module: whose parameters and buffers are saved.
        state: additional tensors by name, for example of the optimizer.
        counters: metadata, ``step`` among them.
    """
    tensors = {f"{_MODEL}{name}": tensor for name, tensor in module.state_dict().items()}
    contiguous = {name: tensor.contiguous() for name, tensor in {**tensors, **state}.items()}
    write_atomically(path, save(contiguous, {name: str(n) for name, n in counters.items()}))


def load_checkpoint(module: nn.Module, path: Path) -> dict[str, Tensor]:
    """Loads a checkpoint into a module and returns its additional tensors.

    Raises:
        InputError: if its parameters have other names or shapes.
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


def read_counters(path: Path) -> dict[str, int]:
    """Reads the counters of a checkpoint."""
    with safe_open(path, framework="pt") as file:
        return {name: int(number) for name, number in file.metadata().items()}
