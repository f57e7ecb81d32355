"""Simulators in worker processes, which set up and render scenes while this one estimates."""

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
    """Proxy of a :class:`~..simulation.simulator.SceneSimulator` in a worker process.

    Args:
        worker: the process, which runs calls in order and may be shared.
        number: of the sub-environment.
    """

    def __init__(self, worker: ProcessPoolExecutor, number: int) -> None:
        self._worker = worker
        self._number = number

    def submit(self, method: str, *arguments: Any) -> Callable[[], Any]:
        """Submits a method call; the returned function waits for its result.

        Raises:
            ChildProcessError: if the process died; the returned function raises it too.
        """
        with _named_death(self._number):
            future = self._worker.submit(_call, self._number, method, arguments)

        def result() -> Any:
            with _named_death(self._number):
                return future.result()

        return result

    def reset(self, request: SceneRequest) -> SceneInfo:
        """Sets up a scene and renders the reference view."""
        return self.submit("reset", request)()

    def render(self, T_cam_world: np.ndarray, number: int) -> np.ndarray:
        """Renders the scene: RGB uint8 (H, W, 3)."""
        return self.submit("render", T_cam_world, number)()

    def visibility_from(self, T_cam_world: np.ndarray) -> float:
        """Visible fraction of the target from a camera (4, 4)."""
        return self.submit("visibility_from", T_cam_world)()

    def close(self) -> None:
        """Does nothing: :class:`SimulatorWorkers` ends the processes."""


class SimulatorWorkers:
    """``count`` processes that share the simulators of several sub-environments."""

    def __init__(self, count: int) -> None:
        self._workers = [new_worker() for _ in range(count)]
        self._simulators = 0

    def add(self, *arguments: Any) -> RemoteSimulator:
        """Returns the next sub-environment's simulator; all have the first one's arguments.

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
            # Python may hang if a process dies before it has read a large task.
            with _named_death(number):
                future.result()
                worker.submit(_set_arguments, pickled)


@contextmanager
def _named_death(number: int) -> Iterator[None]:
    try:
        yield
    except BrokenProcessPool:
        raise ChildProcessError(
            f"the process that renders sub-environment {number} died. Without a message above it "
            "was usually out of memory: try fewer workers, or workers=0"
        ) from None


_arguments: tuple[Any, ...] = ()
_simulators: dict[int, SceneSimulator] = {}


def _set_arguments(pickled: bytes) -> None:
    """In a worker: sets the arguments of its simulators."""
    global _arguments
    _arguments = pickle.loads(pickled)


def _call(number: int, method: str, arguments: tuple[Any, ...]) -> Any:
    """In a worker: calls a method of a sub-environment's simulator."""
    if number not in _simulators:
        _simulators[number] = SceneSimulator(*_arguments)
    return getattr(_simulators[number], method)(*arguments)
