"""Thread pools that run networks in parallel, one core for each thread.

OpenMP splits every operation of a network among its threads, with a barrier after each. On a busy
machine a barrier waits for a thread without a core, hundreds of times an estimate. Threads that
each run the complete network synchronize once.
"""

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cache


def shared_pool(workers: int) -> ThreadPoolExecutor:
    """:func:`single_core_threads`, cached per process."""
    # A forked process does not have its parent's threads.
    return _shared(workers, os.getpid())


@cache
def _shared(workers: int, process: int) -> ThreadPoolExecutor:
    return single_core_threads(workers)


def single_core_threads(workers: int) -> ThreadPoolExecutor:
    """A pool of threads in each of which torch uses one core."""
    import torch  # lazily: importing the environment must stay cheap

    pool = ThreadPoolExecutor(workers, "estimator")
    before = torch.get_num_threads()
    together = threading.Barrier(workers)

    def set_up() -> None:
        torch.get_num_threads()  # the first call in a thread sets its number to the default
        torch.set_num_threads(1)  # of this thread, and the default of later ones
        together.wait()

    for started in [pool.submit(set_up) for _ in range(workers)]:
        started.result()
    torch.set_num_threads(before)
    return pool
