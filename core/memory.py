"""Returns free heap memory to the operating system.

Networks and images allocate arrays of many sizes in changing order, which fragments the heap: the
memory in use stays constant while the process grows.
"""

import ctypes
import sys


def release_unused_memory() -> bool:
    """Returns free pages with glibc's ``malloc_trim``, which takes a few milliseconds.

    Returns:
        Whether any were returned; False where the C library is not glibc.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    return trim is not None and bool(trim(ctypes.c_size_t(0)))
