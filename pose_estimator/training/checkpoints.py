"""Checkpoints of a training stage: one safetensors file, replaced atomically."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from safetensors import SafetensorError, safe_open
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
        InputError: if it is damaged, or its parameters have other names or shapes.
    """
    with _naming(path):
        tensors = load_file(path)
        if not all(tensor.isfinite().all() for tensor in tensors.values()):
            raise ValueError("it holds NaN or infinite numbers")
    names = [name for name in tensors if name.startswith(_MODEL)]
    model = {name.removeprefix(_MODEL): tensors.pop(name) for name in names}
    try:
        module.load_state_dict(model)
    except RuntimeError as error:
        raise InputError(
            f"checkpoint {path} is of networks of another shape; give another --out, or delete it"
        ) from error
    return tensors


def read_counters(path: Path, *names: str) -> dict[str, int]:
    """Reads the counters of a checkpoint, ``step`` and ``names`` among them.

    Raises:
        InputError: if it is damaged, or one of these is missing or no number >= 0.
    """
    with _naming(path), safe_open(path, framework="pt") as file:
        found = {name: int(number) for name, number in (file.metadata() or {}).items()}
        if min(found.get(name, -1) for name in ("step", *names)) < 0:
            raise ValueError(f"its counters are {found}")
        return found


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Names the file, and what to do, where it is damaged."""
    try:
        yield
    except (SafetensorError, ValueError) as error:
        raise InputError(
            f"checkpoint {path} is damaged ({error}): delete it to train this stage again"
        ) from error
