"""The processor that networks run on: its name, what it can do, and how much of that is used."""

from __future__ import annotations

import os
import platform
from functools import cache

from .cpu_cores import available_cores, cpuinfo
from .device import BFLOAT16_FLAGS, has_fast_bfloat16

LIMITS = ("ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA", "ATEN_CPU_CAPABILITY")
"""Variables that forbid a part of a processor's instructions, of oneDNN and of PyTorch itself."""

_INSTRUCTIONS = {"avx512bw": "AVX-512", "avx2": "AVX2", "avx": "AVX"}


@cache
def processor_name() -> str:
    """The model's name, or the architecture's where the system does not tell it."""
    return cpuinfo().get("model name") or platform.processor() or platform.machine()


@cache
def instructions() -> str:
    """The widest instructions that the processor has, in words."""
    flags = cpuinfo().get("flags", "").split()
    widest = next((name for flag, name in _INSTRUCTIONS.items() if flag in flags), "")
    with_bfloat16 = " with bfloat16" if BFLOAT16_FLAGS.intersection(flags) else ""
    return (widest or platform.machine()) + with_bfloat16


def limits() -> str:
    """The variables that forbid instructions, as they are set; empty text where none is."""
    return " ".join(f"{name}={os.environ[name]}" for name in LIMITS if os.environ.get(name))


def number_format() -> str:
    """In what networks compute on the processor: ``bfloat16`` where it is quick, or ``float32``."""
    return "bfloat16" if has_fast_bfloat16() else "float32"


def describe_processor() -> str:
    """One line that figures can be compared by: model, cores, instructions, limits, format."""
    parts = [processor_name(), f"{available_cores()} cores", instructions(), limits()]
    return ", ".join([*filter(None, parts), f"networks in {number_format()}"])
