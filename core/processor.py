"""The CPU that networks run on: name, instruction sets and limits on their use."""

import os
import platform
from functools import cache

from .cpu_cores import available_cores, cpuinfo
from .device import BFLOAT16_FLAGS, has_fast_bfloat16

LIMITS = ("ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA", "ATEN_CPU_CAPABILITY")
"""Variables of oneDNN and PyTorch that restrict the instruction sets."""

_INSTRUCTIONS = {"avx512bw": "AVX-512", "avx2": "AVX2", "avx": "AVX"}


@cache
def processor_name() -> str:
    """The model's name, or the architecture's if that is unknown."""
    return cpuinfo().get("model name") or platform.processor() or platform.machine()


@cache
def instructions() -> str:
    """The widest vector instruction set."""
    flags = cpuinfo().get("flags", "").split()
    widest = next((name for flag, name in _INSTRUCTIONS.items() if flag in flags), "")
    with_bfloat16 = " with bfloat16" if BFLOAT16_FLAGS.intersection(flags) else ""
    return (widest or platform.machine()) + with_bfloat16


def limits() -> str:
    """The variables of ``LIMITS`` that are set; empty without any."""
    return " ".join(f"{name}={os.environ[name]}" for name in LIMITS if os.environ.get(name))


def number_format() -> str:
    """The data type of networks on the CPU: ``bfloat16`` if it is fast, else ``float32``."""
    return "bfloat16" if has_fast_bfloat16() else "float32"


def describe_processor() -> str:
    """One line about the CPU: model, cores, instructions, limits, data type."""
    parts = [processor_name(), f"{available_cores()} cores", instructions(), limits()]
    return ", ".join([*filter(None, parts), f"networks in {number_format()}"])
