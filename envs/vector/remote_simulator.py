"""Simulators in processes of their own.

OpenGL on the CPU and the arrangement of scenes take as long as an estimate does. Next to it, in
another process, they cost no time.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from multiprocessing.reduction import ForkingPickler
from typing import Any

import numpy as np

from ...core.worker_pool import new_worker, single_thread_env, without_script
from ..simulation.simulator import SceneInfo, SceneRequest, SceneSimulator


class RemoteSimulator:
    """A :class:`~.studio.SceneSimulator` in another process, which carries out calls in order.

    Args:
        worker: the process, which may hold others too.
        number: of the sub-environment.
    """

    def __init__(self, worker: ProcessPoolExecutor, number: int) -> None:
        self._worker = worker
        self._number = number

    def submit(self, method: str, *arguments: Any) -> Callable[[], Any]:
        """Begins a call of a method; what is returned waits for its result.

        Raises:
            ChildProcessError: if the process died; then also what is returned raises it.
        """
        with _named_death(self._number):
            future = self._worker.submit(_call, self._number, method, arguments)

        def result() -> Any:
            with _named_death(self._number):
                return future.result()

        return result

    def reset(self, request: SceneRequest) -> SceneInfo:
        """Sets up a scene in place of the one before, and renders the reference view."""
        return self.submit("reset", request)()

    def render(self, T_cam_world: np.ndarray, number: int) -> np.ndarray:
        """Renders the scene: RGB uint8 (H, W, 3)."""
        return self.submit("render", T_cam_world, number)()

    def visibility_from(self, T_cam_world: np.ndarray) -> float:
        """Visible fraction of the target from a camera (4, 4)."""
        return self.submit("visibility_from", T_cam_world)()

    def close(self) -> None:
        """Nothing: the processes are ended together."""


class SimulatorWorkers:
    """Processes that hold the simulators of several sub-environments.

    Args:
        count: how many processes share them.
    """

    def __init__(self, count: int) -> None:
        self._workers = [new_worker() for _ in range(count)]
        self._simulators = 0

    def add(self, *arguments: Any) -> RemoteSimulator:
        """The next sub-environment's simulator; all have the arguments of the first.

        Raises:
            ChildProcessError: if a process died.
        """
        if not self._simulators:
            self._start(arguments)
        number, self._simulators = self._simulators, self._simulators + 1
        return RemoteSimulator(self._workers[number % len(self._workers)], number)

    def close(self) -> None:
        """Ends the processes."""
        for worker in self._workers:
            worker.shutdown(cancel_futures=True)

    def _start(self, arguments: tuple[Any, ...]) -> None:
        pickled = bytes(ForkingPickler.dumps(arguments))
        own_classes = b"__main__" in pickled  # of the caller's script
        with single_thread_env(), nullcontext() if own_classes else without_script():
            started = [worker.submit(os.getpid) for worker in self._workers]
        for number, (worker, future) in enumerate(zip(self._workers, started, strict=True)):
            # Python may wait for ever if a process dies before it has read a large task.
            with _named_death(number):
                future.result()
                worker.submit(_set_arguments, pickled)


@contextmanager
def _named_death(number: int) -> Iterator[None]:
    try:
        yield
    except BrokenProcessPool:
        raise ChildProcessError(
            f"the process that renders sub-environment {number} died. If it says nothing above, "
            "it was usually out of memory: try fewer workers, or workers=0, which renders in this "
            "process"
        ) from None


_arguments: tuple[Any, ...] = ()
_simulators: dict[int, SceneSimulator] = {}


def _set_arguments(pickled: bytes) -> None:
    """In a worker: says what its simulators are made with."""
    global _arguments
    _arguments = pickle.loads(pickled)


def _call(number: int, method: str, arguments: tuple[Any, ...]) -> Any:
    """In a worker: calls a method of a sub-environment's simulator."""
    if number not in _simulators:
        _simulators[number] = SceneSimulator(*_arguments)
    return getattr(_simulators[number], method)(*arguments)
