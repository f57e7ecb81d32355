"""A pool of worker processes for scenes, each with its own GL context.

A worker that dies or holds too much memory is replaced, and a lost scene is retried. Each worker is
an executor of one process: a pool of several cannot replace one of them, and Python's own
``max_tasks_per_child`` hangs in Python 3.11 and 3.12
(https://github.com/python/cpython/issues/115634). The limit is one of memory rather than of tasks
because how much a scene leaks depends on the driver.
"""

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
    """Generates scenes by number, in one process."""

    def make(self, scene_id: int) -> None:
        """Generates and writes a scene."""
        ...

    def close(self) -> None:
        """Frees the GL context."""
        ...


_SINGLE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "LP_NUM_THREADS": "0",  # llvmpipe renders in the worker's own thread
}

MAX_RETRIES = 3
"""Workers that may die on one scene."""


def run_scenes(
    make_task: Callable[[], SceneTask],
    scene_ids: Sequence[int],
    workers: int,
    worker_memory: float = 0.0,
) -> Iterator[int]:
    """Generates scenes and yields the number of each finished one.

    Args:
        make_task: called once in each worker; must be picklable. With one worker, or one scene,
            this process is the worker.
        scene_ids: numbers of the scenes.
        workers: number of processes.
        worker_memory: gigabytes above which a worker is replaced; 0: never.

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
    """Returns the resident memory of this process in bytes; outside of Linux, its peak."""
    if sys.platform == "linux":
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def new_worker() -> ProcessPoolExecutor:
    """Returns an executor of one process, spawned at its first task; it exits with its parent."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, spawn, initializer=_start_child)


@contextmanager
def single_thread_env() -> Iterator[None]:
    """Processes started in this context compute and render with one thread each.

    Environment variables that are already set keep their values.
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
    """Processes spawned in this context do not import the caller's script.

    The script then needs no ``if __name__ == "__main__"``, but nothing that it defines can be
    pickled to them.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


_task: SceneTask | None = None


def _make_scene(make_task: Callable[[], SceneTask], scene_id: int) -> int:
    """Generates a scene in a worker; returns the worker's memory in bytes."""
    global _task
    if _task is None:
        _task = make_task()
    _task.make(scene_id)
    release_unused_memory()
    return memory_in_use()


def _replace(worker: ProcessPoolExecutor) -> ProcessPoolExecutor:
    """Returns a new worker after the old one has exited."""
    worker.shutdown()
    return new_worker()


def _start_child() -> None:
    import cv2

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles it and stops its workers
    # A worker whose parent is killed would wait for tasks forever.
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    cv2.setNumThreads(1)


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
