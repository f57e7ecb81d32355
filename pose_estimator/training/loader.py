"""Batches prefetched by workers: reproducible by number, for any number of workers."""

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

SampleFunction = Callable[..., Sample]
"""Draws a sample with a ``np.random.Generator``; a second argument is shared by its batch."""

_MAX_WORKERS = 16


class NumberedBatches(Dataset[Batch]):
    """Batch n depends on the seed and n only, whichever process draws it.

    Args:
        draw: draws one sample.
        size: samples per batch of each rank.
        seed: of the batches.
        draw_shared: draws what the samples of a batch share, if anything.
    """

    def __init__(
        self,
        draw: SampleFunction,
        size: int,
        seed: int,
        draw_shared: Callable[[np.random.Generator], Any] | None = None,
    ):
        self.draw, self.size, self.seed, self.draw_shared = draw, size, seed, draw_shared
        self.rank, self.world_size = rank(), world_size()

    def __getitem__(self, number: int) -> Batch:
        rng = np.random.default_rng([self.seed, number])
        shared = () if self.draw_shared is None else (self.draw_shared(rng),)
        # W ranks together draw the batch of a single process with W * size samples.
        every = rng.spawn(self.size * self.world_size)
        own = every[self.rank * self.size : (self.rank + 1) * self.size]
        return collate([self.draw(generator, *shared) for generator in own])


def collate(samples: Sequence[Sample]) -> Batch:
    """Collates samples to a batch on the CPU, whatever PyTorch's default device is."""
    with torch.device("cpu"):
        return default_collate(list(samples))


def load(
    batches: NumberedBatches, numbers: Sequence[int], workers: int, device: torch.device
) -> Generator[Batch, None, None]:
    """Yields batches on a device, prefetched by workers.

    The workers end when the iterator is closed, and when this process ends for any reason.

    Args:
        batches: the dataset.
        numbers: numbers of the batches, in order.
        workers: worker processes; 0 = draw in this one.
        device: where the batches go.
    """
    loader = DataLoader(
        batches,
        batch_size=None,
        sampler=numbers,
        num_workers=workers,
        pin_memory=device.type == "cuda",
        worker_init_fn=_limit_threads,
        # A forked worker shares the dataset's memory, and starts at once.
        multiprocessing_context="fork" if workers and sys.platform == "linux" else None,
        generator=torch.Generator("cpu"),  # do not use the global one
    )
    iterator = iter(loader)
    try:
        for batch in iterator:
            yield to_device(batch, device)
    finally:
        del iterator


def to_device(batch: Batch, device: torch.device) -> Batch:
    """Copies a batch to a device, asynchronously from pinned memory."""
    return {name: tensor.to(device, non_blocking=True) for name, tensor in batch.items()}


def default_workers(device: torch.device) -> int:
    """The number of workers for a device: one for a CPU; for a GPU all cores but one, up to 16."""
    if device.type == "cpu":
        return 1
    return min(_MAX_WORKERS, max(1, threads_per_rank() - 1))


def _limit_threads(worker: int) -> None:
    """Gives OpenCV one thread in each worker, as PyTorch does for itself."""
    cv2.setNumThreads(0)
