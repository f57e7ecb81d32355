"""Batches drawn ahead by threads, the same ones whatever came before and however many train."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from .data_parallel import own_share, world_size

_Sample = TypeVar("_Sample")
_Batch = TypeVar("_Batch")


def batches(
    draw: Callable[[np.random.Generator], _Sample],
    size: int,
    seed: int,
    start: int,
    threads: int = 2,
    ahead: int = 3,
) -> Iterator[list[_Sample]]:
    """Endless batches of samples that are drawn each on its own; see :func:`prepared`.

    Args:
        draw: makes one sample.
        size: samples a batch, in each of the processes that train together.
        seed: of everything drawn.
        start: number of the first batch, to resume.
        threads: how many threads.
        ahead: how many batches to prepare ahead.
    """
    return prepared(
        lambda rng: [draw(own) for own in own_generators(rng, size)], seed, start, threads, ahead
    )


def own_generators(rng: np.random.Generator, size: int) -> Sequence[np.random.Generator]:
    """A generator for each of the ``size`` samples that are this process's of a batch.

    W processes get what one with W * ``size`` samples gets, each its part.
    """
    return own_share(rng.spawn(size * world_size()))


def prepared(
    make: Callable[[np.random.Generator], _Batch],
    seed: int,
    start: int,
    threads: int = 2,
    ahead: int = 3,
) -> Iterator[_Batch]:
    """Endless batches, prepared ahead by threads (OpenCV lets go of the interpreter lock).

    Args:
        make: makes one batch.
        seed: of everything drawn; batch n is the same whatever came before it.
        start: number of the first batch, to resume.
        threads: how many threads.
        ahead: how many batches to prepare ahead.
    """

    def numbered(number: int) -> _Batch:
        return make(np.random.default_rng([seed, number]))

    with ThreadPoolExecutor(threads) as pool:
        queue: list[Future[_Batch]] = []
        number = start
        try:
            while True:
                while len(queue) <= ahead:
                    queue.append(pool.submit(numbered, number))
                    number += 1
                yield queue.pop(0).result()
        finally:
            for future in queue:
                future.cancel()
