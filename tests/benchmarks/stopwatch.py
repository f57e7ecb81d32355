"""Times two implementations of one task side by side, as a record of the results file."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

Record = dict[str, Any]
"""One result, with its tags."""

WARM_UP = 2
"""Calls of each side that do not count."""

MISSING = "missing"
"""Metric of a comparison that was not made."""


def missing(against: str, reason: str, install: str) -> Record:
    """The record of a comparison that was not made.

    Args:
        against: what is missing or does not work.
        reason: why.
        install: how to install it.
    """
    names = {"against": against, "reason": reason, "install": install}
    return {"metric": MISSING, "value": 0, "unit": "", **names}


def timed(work: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    """Wall time of one call in seconds, and what it returned."""
    start = time.perf_counter()
    answer = work(*arguments)
    return time.perf_counter() - start, answer


def seconds(work: Callable[..., Any], *arguments: Any) -> float:
    """Wall time of one call."""
    return timed(work, *arguments)[0]


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
    ours: Callable[..., Any],
    theirs: Callable[[], Any],
    repeats: int,
    goal: float,
    share: int = 1,
    prepare: Callable[[], tuple[Any, ...]] = tuple,
) -> Record:
    """Times two calls in turn, after two of each that do not count; see :func:`make_record`.

    ``prepare`` gives the arguments of each call of ``ours``, and is not timed.
    """
    rounds = [(seconds(ours, *prepare()), seconds(theirs)) for _ in range(repeats + WARM_UP)]
    our_times, their_times = zip(*rounds[WARM_UP:], strict=True)
    return make_record(work, against, our_times, their_times, goal, share)


def make_record(
    work: str,
    against: str,
    ours: Sequence[float],
    theirs: Sequence[float],
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
