"""Batches drawn ahead by workers: the same ones whatever came before, and however many draw."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, default_collate

from .distributed import rank, threads_per_rank, world_size

Sample = Mapping[str, Any]
"""Arrays and numbers by name."""

Batch = dict[str, Tensor]
"""Samples as tensors (B, ...) by name."""

Draw = Callable[..., Sample]
"""Draws a sample with a ``np.random.Generator``; a second argument is what its batch shares."""

_MAX_WORKERS = 16


class NumberedBatches(Dataset[Batch]):
    """Batch n is the same whatever came before it, and in whichever process it is drawn.

    Args:
        draw: makes one sample.
        size: samples a batch, in each of the processes that train together.
        seed: of everything drawn.
        choose: draws what the samples of a batch share; None: nothing.
    """

    def __init__(
        self,
        draw: Draw,
        size: int,
        seed: int,
        choose: Callable[[np.random.Generator], Any] | None = None,
    ):
        self.draw, self.size, self.seed, self.choose = draw, size, seed, choose
        self.rank, self.world_size = rank(), world_size()

    def __getitem__(self, number: int) -> Batch:
        rng = np.random.default_rng([self.seed, number])
        shared = () if self.choose is None else (self.choose(rng),)
        # W processes get what one with W * size samples gets, each its part.
        every = rng.spawn(self.size * self.world_size)
        own = every[self.rank * self.size : (self.rank + 1) * self.size]
        return collate([self.draw(generator, *shared) for generator in own])


def collate(samples: Sequence[Sample]) -> Batch:
    """Samples as one batch on the processor, whatever PyTorch's default device is."""
    with torch.device("cpu"):
        return default_collate(list(samples))


def load(
    batches: NumberedBatches, numbers: Sequence[int], workers: int, device: torch.device
) -> Generator[Batch, None, None]:
    """Batches on a device, drawn ahead.

    Closing the iterator ends the workers; so does the end of this process, however it ends.

    Args:
        batches: what to draw.
        numbers: which ones, in this order.
        workers: processes that draw; 0: this one, when a batch is asked for.
        device: where the batches go; to a GPU while it computes.
    """
    loader = DataLoader(
        batches,
        batch_size=None,
        sampler=numbers,
        num_workers=workers,
        pin_memory=device.type == "cuda",
        worker_init_fn=_work_on_one_core,
        # A forked worker shares the dataset's memory, and starts at once.
        multiprocessing_context="fork" if workers and sys.platform == "linux" else None,
        generator=torch.Generator("cpu"),  # else it would draw from the one that all share
    )
    iterator = iter(loader)
    try:
        for batch in iterator:
            yield to_device(batch, device)
    finally:
        del iterator


def to_device(batch: Batch, device: torch.device) -> Batch:
    """A batch on a device; from pinned memory that does not wait."""
    return {name: tensor.to(device, non_blocking=True) for name, tensor in batch.items()}


def default_workers(device: torch.device) -> int:
    """How many workers feed a device: a GPU all cores but one, 16 at most; a processor one."""
    if device.type == "cpu":
        return 1
    return min(_MAX_WORKERS, max(1, threads_per_rank() - 1))


def _work_on_one_core(worker: int) -> None:
    """Each worker is one of many: PyTorch gives it one thread, and this does the same to OpenCV."""
    cv2.setNumThreads(0)
