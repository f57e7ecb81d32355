"""Scenes made by several processes of this machine, each with its own GL context.

A worker that has come to hold too much memory is replaced by a fresh one, and so is one that died;
its scene is made again. Each worker is an executor of one process: a pool of several cannot replace
one of them, and Python's own ``max_tasks_per_child`` hangs in Python 3.11 and 3.12
(https://github.com/python/cpython/issues/115634). A limit of memory is also what is meant: how much
a scene leaves behind depends on the driver.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import types
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Protocol


class Maker(Protocol):
    """Makes scenes by their numbers, in one process."""

    def make(self, scene_id: int) -> None:
        """Makes a scene and writes it."""
        ...


class MakerConfig(Protocol):
    """What a pool needs to know; it travels to the workers.

    Attributes:
        workers: processes.
        worker_memory: gigabytes from which on a worker is replaced; 0: never.
    """

    @property
    def workers(self) -> int: ...
    @property
    def worker_memory(self) -> float: ...

    def maker(self) -> Maker:
        """A maker, made where it works."""
        ...


_QUIET_THREADS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "LP_NUM_THREADS": "0",  # llvmpipe draws in the worker itself: workers are the parallelism
}
"""What the workers' environment says unless the caller's own says otherwise."""

TRIES = 3
"""How often a scene is begun whose workers die."""


def quiet_threads() -> dict[str, str]:
    """What a worker's environment is to say of threads, but for what the caller's own says."""
    return {name: value for name, value in _QUIET_THREADS.items() if name not in os.environ}


def make_scenes(config: MakerConfig, scene_ids: Iterable[int]) -> Iterator[int]:
    """Makes scenes and yields the number of each that is ready.

    Raises:
        ChildProcessError: if the workers of one scene died ``TRIES`` times.
    """
    waiting = deque(scene_ids)
    added = quiet_threads()
    os.environ.update(added)  # the workers inherit it
    deaths: Counter[int] = Counter()
    running: dict[Future[int], tuple[ProcessPoolExecutor, int]] = {}
    idle = [_new_worker(config) for _ in range(min(config.workers, len(waiting)))]
    try:
        while waiting or running:
            while waiting and idle:
                worker, scene_id = idle.pop(), waiting.popleft()
                running[worker.submit(make_one, scene_id)] = worker, scene_id
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                worker, scene_id = running.pop(future)
                idle.append(worker)
                try:
                    memory = future.result()
                except BrokenProcessPool:
                    deaths[scene_id] += 1
                    if deaths[scene_id] == TRIES:
                        raise ChildProcessError(
                            f"{TRIES} workers died on scene {scene_id}. Often memory is why: try "
                            "fewer workers, or one, which shows the error"
                        ) from None
                    waiting.appendleft(scene_id)
                    idle[-1] = _replace(worker, config)
                    continue
                if 0 < config.worker_memory * 1e9 < memory and waiting:
                    idle[-1] = _replace(worker, config)
                yield scene_id
    finally:
        for worker in [*idle, *(worker for worker, _ in running.values())]:
            worker.shutdown(cancel_futures=True)
        for name in added:
            del os.environ[name]


def memory_in_use() -> int:
    """Bytes of memory that this process holds; the most it ever held where Linux cannot say."""
    if sys.platform == "linux":
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


_maker: Maker | None = None


def start_worker(config: MakerConfig) -> None:
    """In a worker: makes ready to make scenes."""
    global _maker
    import cv2

    cv2.setNumThreads(1)
    _maker = config.maker()


def make_one(scene_id: int) -> int:
    """In a worker: makes a scene; returns the bytes of memory that the worker holds."""
    assert _maker is not None
    _maker.make(scene_id)
    return memory_in_use()


def _new_worker(config: MakerConfig) -> ProcessPoolExecutor:
    """A worker; its process starts with its first scene."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, spawn, initializer=_start_child, initargs=(config,))


def _replace(worker: ProcessPoolExecutor, config: MakerConfig) -> ProcessPoolExecutor:
    """A fresh worker, once the old one has given back its memory."""
    worker.shutdown()
    return _new_worker(config)


def _start_child(config: MakerConfig) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it and ends its workers
    leave_with_parent()
    start_worker(config)


@contextmanager
def without_script() -> Iterator[None]:
    """Processes that start in here do not run the caller's script anew, as spawned ones do.

    So the script need not say ``if __name__ == "__main__"``; but nothing that it defines may go to
    them.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def leave_with_parent() -> None:
    """In a worker: ends it when its parent is killed, for which a queue would wait for ever."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
