"""Memory that is free goes back to the system now and then.

Networks and pictures take arrays of many sizes in changing order. What is in use stays the same,
but the allocator's holes between it grow by a jump every few thousand steps, and never shrink.
"""

from __future__ import annotations

import ctypes
import sys
from functools import lru_cache
from typing import Any

EPISODES = 100
"""After how many of its episodes an environment gives free memory back."""


def give_back() -> bool:
    """Gives free pages back to the system, which takes a few milliseconds.

    Returns:
        Whether any were; never where the C library is not GNU's.
    """
    trim = _malloc_trim()
    return trim is not None and bool(trim(0))


@lru_cache(maxsize=1)
def _malloc_trim() -> Any:
    if sys.platform != "linux":
        return None
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # musl has none
    if trim is not None:
        trim.argtypes, trim.restype = [ctypes.c_size_t], ctypes.c_int
    return trim
