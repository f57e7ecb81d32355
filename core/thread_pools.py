"""Threads that run networks side by side, each on one core.

OpenMP shares every operation of a network among its threads, which meet at a barrier after each.
On a machine with other work a barrier waits for a thread that has no core, hundreds of times an
estimate. Threads that each take a piece of work through the whole network meet once.
"""

from __future__ import annotations

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cache


def shared_pool(workers: int) -> ThreadPoolExecutor:
    """:func:`single_core_threads` that are kept for the whole process."""
    # A forked process has none of its parent's threads.
    return _shared(workers, os.getpid())


@cache
def _shared(workers: int, process: int) -> ThreadPoolExecutor:
    return single_core_threads(workers)


def single_core_threads(workers: int) -> ThreadPoolExecutor:
    """Threads in each of which torch computes on one core."""
    import torch  # importing the environment, which imports this, must stay cheap

    pool = ThreadPoolExecutor(workers, "estimator")
    before = torch.get_num_threads()
    together = threading.Barrier(workers)

    def set_up() -> None:
        torch.get_num_threads()  # what a thread first asks for its number sets to the default
        torch.set_num_threads(1)  # of this thread, and the default of those that are started later
        together.wait()

    for started in [pool.submit(set_up) for _ in range(workers)]:
        started.result()
    torch.set_num_threads(before)
    return pool
