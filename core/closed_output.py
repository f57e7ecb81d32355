"""The end of a pipe whose reader has gone, as after ``| head -1``."""

import os
import select
import sys


def close_broken_output() -> bool:
    """Discards what is still written to a standard stream that nobody reads any more.

    Returns:
        Whether there is such a stream.
    """
    broken = False
    for stream in (sys.stdout, sys.stderr):
        try:
            descriptor = stream.fileno()
        except (AttributeError, OSError, ValueError):  # there is none, or it is captured
            continue
        poll = select.poll()
        poll.register(descriptor, 0)
        if any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0)):
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, descriptor)
            os.close(nothing)
            broken = True
    return broken
