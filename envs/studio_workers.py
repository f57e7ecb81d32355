"""Studios in processes of their own, whose pictures come through shared memory.

OpenGL on the CPU and the arrangement of scenes take as long as an estimate does. Beside it, in
another process, they cost no time. Orders go through a pipe, in order; a picture is written where
the environment reads it, and is never copied.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import traceback
from collections import deque
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from multiprocessing.sharedctypes import RawArray
from typing import Any, NamedTuple

import numpy as np

from .studio import LocalStudio, SceneOrder, Setup, StudioConfig
from .worker_pool import leave_with_parent, quiet_threads, without_script

_SLOTS = 4
"""Pictures of one lane that are kept: two of an episode, and those of the next."""


class _Order(NamedTuple):
    """What a worker is to do: ``lane``'s studio's method ``name`` with ``arguments``.

    Attributes:
        slot: where a picture goes; None where there is none.
    """

    lane: int
    name: str
    arguments: tuple[Any, ...]
    slot: int | None = None


class StudioWorkers:
    """Processes with the studios of several lanes.

    Args:
        config: of every studio.
        lanes: how many studios.
        workers: how many processes share them.
    """

    def __init__(self, config: StudioConfig, lanes: int, workers: int) -> None:
        height, width = config.resolution
        shape = (lanes, _SLOTS, height, width, 3)
        memory = RawArray("B", int(np.prod(shape)))
        self.pictures = np.frombuffer(memory, np.uint8).reshape(shape)
        spawn = multiprocessing.get_context("spawn")
        self._pipes: list[Connection] = []
        self._processes = []
        self._unanswered = [0] * min(workers, lanes)
        added = quiet_threads()
        os.environ.update(added)  # the workers inherit it
        pickled = ForkingPickler.dumps(config)
        own_classes = b"__main__" in bytes(pickled)  # of the caller's script
        try:
            for _ in range(min(workers, lanes)):
                ours, theirs = spawn.Pipe()
                process = spawn.Process(target=_work, args=(memory, shape, theirs), daemon=True)
                with nullcontext() if own_classes else without_script():
                    process.start()
                theirs.close()
                # Not among the arguments: Python waits for ever if a process dies before it has
                # read many of them.
                with suppress(OSError):  # the first order says so
                    ours.send_bytes(pickled)
                self._pipes.append(ours)
                self._processes.append(process)
        finally:
            for name in added:
                del os.environ[name]

    def send(self, order: _Order) -> None:
        """Gives an order to the worker of its lane.

        Raises:
            ChildProcessError: if the worker is gone.
        """
        try:
            self._pipe(order.lane).send(order)
        except OSError:
            raise self._gone(order.lane) from None
        self._unanswered[order.lane % len(self._pipes)] += 1

    def receive(self, lane: int) -> Any:
        """The answer to the oldest order of a worker that has not been answered.

        Raises:
            ChildProcessError: if the worker is gone.
            Exception: what the order raised.
        """
        answer, error = self._next_answer(lane)
        if error is not None:
            raise error
        return answer

    def drain(self) -> None:
        """Waits for the answers to all orders, and drops them, also what they raised.

        Raises:
            ChildProcessError: if a worker is gone.
        """
        for lane, count in enumerate(list(self._unanswered)):  # the first lane of each worker
            for _ in range(count):
                self._next_answer(lane)

    def close(self) -> None:
        """Ends the workers."""
        for pipe in self._pipes:
            pipe.close()
        for process in self._processes:
            process.join(5)
            if process.is_alive():
                process.terminate()
                process.join()
        self._pipes, self._processes = [], []

    def _pipe(self, lane: int) -> Connection:
        return self._pipes[lane % len(self._pipes)]

    def _next_answer(self, lane: int) -> tuple[Any, Exception | None]:
        try:
            answer: tuple[Any, Exception | None] = self._pipe(lane).recv()
        except (EOFError, OSError):
            raise self._gone(lane) from None
        self._unanswered[lane % len(self._pipes)] -= 1
        return answer

    def _gone(self, lane: int) -> ChildProcessError:
        process = self._processes[lane % len(self._processes)]
        process.join(1)
        return ChildProcessError(
            f"the process that renders lane {lane} ended with code {process.exitcode}. If it says "
            "nothing above, memory is often why: try fewer workers, or workers=0, which renders in "
            "this process"
        )


class RemoteStudio:
    """One lane's studio among the workers.

    Answers come in the order of the orders, of all lanes of a worker: what was ordered first must
    be collected first.

    Args:
        workers: where it is.
        lane: its number.
    """

    def __init__(self, workers: StudioWorkers, lane: int) -> None:
        self._workers = workers
        self._lane = lane
        self._slot = 0
        self._ordered: deque[int | None] = deque()

    def order_opening(self, order: SceneOrder) -> None:
        """Orders a scene and the reference picture of it."""
        self._send("open", (order,), picture=True)

    def order_picture(self, T_cam_world: np.ndarray, number: int) -> None:
        """Orders a picture; see :meth:`shoot`."""
        self._send("shoot", (T_cam_world, number), picture=True)

    def collect(self) -> tuple[Any, np.ndarray]:
        """What was ordered first: what the order returned, and the picture."""
        answer, slot = self._workers.receive(self._lane), self._ordered.popleft()
        assert slot is not None
        return answer, self._workers.pictures[self._lane, slot]

    def forget(self) -> None:
        """Takes back what was ordered, after the workers were drained."""
        self._ordered.clear()

    def arrange(self, order: SceneOrder) -> Setup:
        """Sets up a scene in place of the one before."""
        return self._call("arrange", order)

    def shoot(self, T_cam_world: np.ndarray, number: int) -> np.ndarray:
        """Takes a picture of the scene: RGB uint8 (H, W, 3)."""
        self.order_picture(T_cam_world, number)
        return self.collect()[1]

    def visibility_from(self, T_cam_world: np.ndarray) -> float:
        """Visible fraction of the target from a camera (4, 4)."""
        return self._call("visibility_from", T_cam_world)

    def close(self) -> None:
        """Nothing: the workers are ended together."""

    def _call(self, name: str, *arguments: Any) -> Any:
        self._send(name, arguments, picture=False)
        answer = self._workers.receive(self._lane)
        self._ordered.popleft()
        return answer

    def _send(self, name: str, arguments: tuple[Any, ...], *, picture: bool) -> None:
        slot = None
        if picture:
            slot, self._slot = self._slot, (self._slot + 1) % _SLOTS
        self._workers.send(_Order(self._lane, name, arguments, slot))
        self._ordered.append(slot)


def _work(memory: Any, shape: Sequence[int], pipe: Connection) -> None:
    """In a worker: is told of the studios, and carries out orders until there will be no more."""
    import cv2

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it and ends its workers
    leave_with_parent()
    cv2.setNumThreads(1)
    pictures = np.frombuffer(memory, np.uint8).reshape(shape)
    config: StudioConfig = pipe.recv()
    studios: dict[int, LocalStudio] = {}
    while True:
        try:
            order: _Order = pipe.recv()
        except EOFError:
            break
        try:
            if order.lane not in studios:
                studios[order.lane] = LocalStudio(config)
            pipe.send((_carry_out(order, studios[order.lane], pictures), None))
        except Exception as error:
            error.add_note("in a rendering worker:\n" + traceback.format_exc())
            pipe.send((None, error))
    for studio in studios.values():
        studio.close()


def _carry_out(order: _Order, studio: LocalStudio, pictures: np.ndarray) -> Any:
    if order.name == "open":
        setup = studio.arrange(*order.arguments)
        pictures[order.lane, order.slot] = studio.shoot(setup.T_cam_world, 0)
        return setup
    answer = getattr(studio, order.name)(*order.arguments)
    if order.slot is None:
        return answer
    pictures[order.lane, order.slot] = answer
    return None
