"""The device on which networks run, and whether it is fast in bfloat16."""

from __future__ import annotations

import os
from functools import cache
from typing import TYPE_CHECKING

from .cpu_cores import cpuinfo
from .errors import InputError

if TYPE_CHECKING:
    import torch

DEVICES = "auto, cpu, cuda, cuda:N or mps"
"""Devices of :func:`resolve_device`, for messages."""

BFLOAT16_FLAGS = frozenset({"avx512_bf16", "amx_bf16"})
"""CPU flags of instructions that multiply bfloat16 matrices, as Linux names them."""


def resolve_device(device: str | torch.device = "auto") -> torch.device:
    """Returns the torch device for a name.

    Args:
        device: ``auto`` (a CUDA GPU, else Apple's, else the processor), ``cpu``, ``cuda``,
            ``cuda:N`` or ``mps``.

    Raises:
        InputError: if the name is unknown or this machine has no such device.
    """
    import torch

    if str(device) == "auto":
        if torch.cuda.is_available():
            return torch.device("cuda")
        return torch.device("mps" if torch.backends.mps.is_available() else "cpu")
    try:
        found = torch.device(device)
    except RuntimeError:
        raise InputError(f"device must be {DEVICES}, got {str(device)!r}") from None
    if found.type not in ("cpu", "cuda", "mps"):
        raise InputError(f"device must be {DEVICES}, got {str(device)!r}")
    if found.type == "cuda":
        _check_cuda(found)
    if found.type == "mps" and not torch.backends.mps.is_available():
        raise InputError(f"device {str(device)!r}: this machine has no Apple GPU; use cpu or auto")
    return found


def check_device(device: str) -> None:
    """Checks early that a device exists; imports torch only if needed.

    Raises:
        InputError: see :func:`resolve_device`.
    """
    if device not in ("auto", "cpu"):
        resolve_device(device)


def _check_cuda(device: torch.device) -> None:
    import torch

    if torch.version.cuda is None and torch.version.hip is None:
        raise InputError(
            f"device {str(device)!r}: this build of PyTorch ({torch.__version__}) has no CUDA; "
            "install one that has (pytorch.org), or use cpu or auto"
        )
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if count == 0:
        raise InputError(
            f"device {str(device)!r}: PyTorch sees no GPU (does nvidia-smi list one, and is its "
            "driver new enough?); use cpu or auto"
        )
    if device.index is not None and device.index >= count:
        names = ", ".join(f"cuda:{number}" for number in range(count))
        raise InputError(f"device {str(device)!r}: this machine has {names}")


def describe(device: torch.device) -> str:
    """The device, with a GPU's name."""
    import torch

    if device.type == "cuda":
        return f"{device} ({torch.cuda.get_device_name(device)})"
    return str(device)


def uses_bfloat16(device: torch.device) -> bool:
    """Whether convolutions run in bfloat16, where that is faster than float32."""
    import torch

    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return device.type == "cpu" and has_fast_bfloat16()


@cache
def has_fast_bfloat16() -> bool:
    """Whether this CPU multiplies bfloat16 matrices in hardware, and oneDNN may use that."""
    limit = os.environ.get("ONEDNN_MAX_CPU_ISA", os.environ.get("DNNL_MAX_CPU_ISA", "")).upper()
    if limit and "BF16" not in limit and "AMX" not in limit and limit not in ("ALL", "DEFAULT"):
        return False
    return not BFLOAT16_FLAGS.isdisjoint(cpuinfo().get("flags", "").split())
