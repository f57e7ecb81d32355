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
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from typing import Protocol

from .memory import release_unused_memory


class SceneTask(Protocol):
    """Makes scenes by their numbers, in one process."""

    def make(self, scene_id: int) -> None:
        """Makes a scene and writes it."""
        ...

    def close(self) -> None:
        """Frees the GL context."""
        ...


_SINGLE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "LP_NUM_THREADS": "0",  # llvmpipe draws in the worker itself: workers are the parallelism
}

MAX_RETRIES = 3
"""How many workers may die on one scene."""


def run_scenes(
    make_task: Callable[[], SceneTask],
    scene_ids: Sequence[int],
    workers: int,
    worker_memory: float = 0.0,
) -> Iterator[int]:
    """Makes scenes and yields the number of each that is ready.

    Args:
        make_task: called once in each worker; it is pickled. With one worker, or one scene, this
            process is the worker.
        scene_ids: which scenes.
        workers: processes.
        worker_memory: gigabytes from which on a worker is replaced; 0: never.

    Raises:
        ChildProcessError: if ``MAX_RETRIES`` workers died on one scene.
    """
    if not scene_ids:
        return
    if workers == 1 or len(scene_ids) == 1:
        with closing(make_task()) as task:
            for scene_id in scene_ids:
                task.make(scene_id)
                release_unused_memory()
                yield scene_id
        return
    waiting = deque(scene_ids)
    deaths: Counter[int] = Counter()
    running: dict[Future[int], tuple[ProcessPoolExecutor, int]] = {}
    idle = [new_worker() for _ in range(min(workers, len(waiting)))]
    try:
        while waiting or running:
            while waiting and idle:
                worker, scene_id = idle.pop(), waiting.popleft()
                with single_thread_env():
                    future = worker.submit(_make_scene, make_task, scene_id)
                running[future] = worker, scene_id
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                worker, scene_id = running.pop(future)
                idle.append(worker)
                try:
                    memory = future.result()
                except BrokenProcessPool:
                    deaths[scene_id] += 1
                    if deaths[scene_id] == MAX_RETRIES:
                        raise ChildProcessError(
                            f"{MAX_RETRIES} workers died on scene {scene_id}, usually out of "
                            "memory: try fewer workers, or one, which shows the error"
                        ) from None
                    waiting.appendleft(scene_id)
                    idle[-1] = _replace(worker)
                    continue
                if 0 < worker_memory * 1e9 < memory:
                    idle[-1] = _replace(worker)
                yield scene_id
    finally:
        for worker in [*idle, *(worker for worker, _ in running.values())]:
            worker.shutdown(cancel_futures=True)


def memory_in_use() -> int:
    """Bytes of memory that this process holds; the most it ever held where Linux cannot say."""
    if sys.platform == "linux":
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def new_worker() -> ProcessPoolExecutor:
    """An executor of one process, which is spawned with its first task and ends with its parent."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, spawn, initializer=_start_child)


@contextmanager
def single_thread_env() -> Iterator[None]:
    """Processes that start in here compute and draw with one thread each.

    What the caller's own environment says of threads stays.
    """
    added = {name: value for name, value in _SINGLE_THREAD.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


@contextmanager
def without_script() -> Iterator[None]:
    """Processes that start in here do not run the caller's script again, as spawned ones do.

    So the script need not say ``if __name__ == "__main__"``; but nothing that it defines may go to
    them.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


_task: SceneTask | None = None


def _make_scene(make_task: Callable[[], SceneTask], scene_id: int) -> int:
    """In a worker: makes a scene; returns the bytes of memory that the worker holds."""
    global _task
    if _task is None:
        _task = make_task()
    _task.make(scene_id)
    release_unused_memory()
    return memory_in_use()


def _replace(worker: ProcessPoolExecutor) -> ProcessPoolExecutor:
    """A fresh worker, once the old one has given back its memory."""
    worker.shutdown()
    return new_worker()


def _start_child() -> None:
    import cv2

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it and ends its workers
    # A worker whose parent is killed would wait for tasks for ever.
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    cv2.setNumThreads(1)


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
