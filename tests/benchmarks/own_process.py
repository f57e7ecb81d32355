"""Runs a generator in a fresh process, and yields its items."""

from __future__ import annotations

import multiprocessing
import os
import signal
import traceback
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection
from typing import Any, TypeVar

_GRACE = 1.0
"""Seconds for a process to end by itself: an interrupt from a terminal reaches it as well."""

T = TypeVar("T")


def each_from_own_process(function: Callable[..., Iterable[T]], *arguments: Any) -> Iterator[T]:
    """Calls a function in a fresh process and yields each item that it yields, as it comes.

    Args:
        function: of a module's top level.
        *arguments: they and what is yielded travel as pickles.

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
                item, error = ours.recv()
            except EOFError:
                break
            if error is not None:
                raise error
            yield item
        process.join()
        if process.exitcode:
            raise ChildProcessError(f"{function.__name__} ended with code {process.exitcode}")
    finally:
        ours.close()
        process.join(_GRACE if process.exitcode is None else 0)
        if process.is_alive() and process.pid is not None:
            os.kill(process.pid, signal.SIGINT)  # so that it ends its own child processes
        process.join()


def _send_each(pipe: Connection, function: Callable[..., Iterable[Any]], arguments: Any) -> None:
    try:
        for item in function(*arguments):
            pipe.send((item, None))
    except (BrokenPipeError, KeyboardInterrupt):
        return  # the consumer is gone
    except Exception as error:
        error.add_note(traceback.format_exc())
        pipe.send((None, error))
