"""Gives free heap memory back to the operating system.

Networks and images take arrays of many sizes in changing order. What is in use stays the same, but
the allocator's holes between it grow by a jump every few thousand steps, and never shrink.
"""

from __future__ import annotations

import ctypes
import sys


def release_unused_memory() -> bool:
    """Gives free pages back with glibc's ``malloc_trim``, which takes a few milliseconds.

    Returns:
        Whether any were given back; never where the C library is not glibc (musl has no
        ``malloc_trim``).
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    return trim is not None and bool(trim(ctypes.c_size_t(0)))
