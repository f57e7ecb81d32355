"""Times two ways of doing one thing, side by side, and writes down what came of it.

Machines differ and drift, so both sides of a comparison take turns in one process, and medians
count.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import numpy as np

Record = dict[str, Any]
"""One number of a results file, with its tags."""

WARM_UP = 2
"""Calls of each side that do not count."""

_GRACE = 1.0
"""Seconds in which a process may end of itself: an interrupt from a terminal reaches it as well."""

T = TypeVar("T")


@dataclass(frozen=True)
class Missing:
    """A comparison that was not made.

    Attributes:
        against: what is not there, or does not work.
        reason: why.
        install: what to type to have it.
    """

    against: str
    reason: str
    install: str

    def __str__(self) -> str:
        return f"not compared with {self.against} ({self.reason}). To install it: {self.install}"


def seconds(work: Callable[[], Any]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def in_turn(works: Sequence[Callable[[], Any]], repeats: int) -> list[list[float]]:
    """Times several calls in turn, after two of each that do not count.

    Returns:
        Seconds of every timed call of each, in the order of ``works``.
    """
    rounds = [[seconds(work) for work in works] for _ in range(repeats + WARM_UP)]
    return [list(times) for times in zip(*rounds[WARM_UP:], strict=True)]


def ratio(
    work: str,
    against: str,
    ours: Callable[[], Any],
    theirs: Callable[[], Any],
    repeats: int,
    goal: float,
    share: int = 1,
) -> Record:
    """Times two calls in turn; see :func:`make_record`."""
    our_times, their_times = in_turn([ours, theirs], repeats)
    return make_record(work, against, our_times, their_times, goal, share)


def make_record(
    work: str,
    against: str,
    ours: list[float],
    theirs: list[float],
    goal: float,
    share: int = 1,
) -> Record:
    """The record of a comparison: how many times as fast ours is.

    Args:
        work: what was done.
        against: how others do it.
        ours: seconds of each repeat.
        theirs: the same of the other side.
        goal: the ratio that ours is to reach.
        share: how many things each repeat did; ``seconds`` are for one of them.
    """
    ours_median, theirs_median = float(np.median(ours)), float(np.median(theirs))
    return {
        "metric": "ratio",
        "value": theirs_median / ours_median,
        "unit": "",
        "work": work,
        "against": against,
        "goal": goal,
        "seconds": ours_median / share,
        "seconds_against": theirs_median / share,
        "n": len(ours),
    }


def in_own_process(function: Callable[..., T], *arguments: Any) -> T:
    """Calls a function in a fresh process: libraries that disturb each other never meet.

    Args:
        function: of a module's top level.
        *arguments: they and what is returned travel as pickles.
    """
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, spawn) as process:
        return process.submit(function, *arguments).result()


def each_from_own_process(function: Callable[..., Iterable[T]], *arguments: Any) -> Iterator[T]:
    """Calls a function in a fresh process and yields each thing that it yields, as it comes.

    Args:
        function: as for :func:`in_own_process`.
        *arguments: likewise.

    Raises:
        ChildProcessError: if the process dies. What the function raises is raised here, too.
    """
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_send_each, args=(theirs, function, arguments))
    process.start()
    theirs.close()
    try:
        while True:
            try:
                thing, error = ours.recv()
            except EOFError:
                break
            if error is not None:
                raise error
            yield thing
        process.join()
        if process.exitcode:
            raise ChildProcessError(f"{function.__name__} ended with code {process.exitcode}")
    finally:
        ours.close()
        process.join(_GRACE if process.exitcode is None else 0)
        if process.is_alive() and process.pid is not None:
            os.kill(process.pid, signal.SIGINT)  # so that it ends the processes of its own
        process.join()


def _send_each(pipe: Connection, function: Callable[..., Iterable[Any]], arguments: Any) -> None:
    try:
        for thing in function(*arguments):
            pipe.send((thing, None))
    except BrokenPipeError:
        return  # nobody listens any more
    except KeyboardInterrupt:
        return  # as its parent is, or by it
    except Exception as error:
        error.add_note(traceback.format_exc())
        pipe.send((None, error))
