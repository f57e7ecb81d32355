"""Several processes that train one set of weights, started by ``torchrun``.

Each process draws its share of a batch and PyTorch's DistributedDataParallel averages their
gradients (Li et al., "PyTorch Distributed", VLDB 2020). On GPUs batch norms normalize by the whole
batch (SyncBatchNorm). PyTorch has no such batch norm for processors: there each process normalizes
by its own share, and the first one's running statistics are kept. A loss that is a quotient of sums
over a batch, the detector's, is each share's own in both.

Without ``torchrun``, or with one process, every function here does nothing, or the same at once.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from datetime import timedelta
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from ...core.cpu_cores import available_cores
from ...core.device import resolve_device
from ...core.errors import InputError

_Result = TypeVar("_Result")

_TIMEOUT = timedelta(days=1)
"""How long processes wait for the first, which packs data and validates while they do; that one of
them ended is noticed at once."""


def own_device(asked: str) -> torch.device:
    """The device of this process: of several on one machine, each takes a GPU of its own.

    Args:
        asked: see :func:`resolve_device`.

    Raises:
        InputError: if there is no such device, or not one for each process.
    """
    device = resolve_device(asked)
    if int(os.environ.get("WORLD_SIZE", "1")) < 2 or device.type == "cpu":
        return device
    if device.type != "cuda":
        raise InputError(f"several processes cannot train on {device}: give --device cpu or cuda")
    if device.index is not None:
        raise InputError(
            f"torchrun gives each process a GPU of its own, and --device is {device}: "
            "give --device cuda, and choose among GPUs by CUDA_VISIBLE_DEVICES"
        )
    number, gpus = int(os.environ.get("LOCAL_RANK", "0")), torch.cuda.device_count()
    if number >= gpus:
        raise InputError(
            f"torchrun started {_ranks_on_this_machine()} processes on a machine with {gpus} GPUs: "
            f"give --nproc-per-node={gpus}, or --device cpu"
        )
    return torch.device("cuda", number)


@contextlib.contextmanager
def process_group(device: torch.device) -> Iterator[None]:
    """Joins the processes that ``torchrun`` started, and leaves them in the end, on errors too.

    All but the first print nothing: what they would say is the same.

    Args:
        device: of this process.
    """
    if device.type == "cuda":
        torch.cuda.set_device(device)
    if int(os.environ.get("WORLD_SIZE", "1")) < 2 or "RANK" not in os.environ or _joined():
        yield
        return
    # What is said beside gradients stays on the processor, and waits for no GPU.
    backend = "cpu:gloo,cuda:nccl" if device.type == "cuda" else "gloo"
    dist.init_process_group(backend, timeout=_TIMEOUT)
    try:
        with contextlib.ExitStack() as stack:
            if rank():
                nothing = stack.enter_context(open(os.devnull, "w"))
                stack.enter_context(contextlib.redirect_stdout(nothing))
            yield
            agreed(True)  # a process that ends earlier would look like one that failed
    finally:
        dist.destroy_process_group()


def _joined() -> bool:
    return dist.is_available() and dist.is_initialized()


def rank() -> int:
    """The number of this process; the first, 0, alone writes files."""
    return dist.get_rank() if _joined() else 0


def world_size() -> int:
    """How many processes train together."""
    return dist.get_world_size() if _joined() else 1


def _ranks_on_this_machine() -> int:
    """How many processes train together on this machine."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", world_size()))


def threads_per_rank() -> int:
    """This process's share of the cores, at least 1.

    ``torchrun`` itself would give each process one thread, however many cores there are.
    """
    return max(1, available_cores() // _ranks_on_this_machine())


def agreed(decision: bool) -> bool:
    """The first process's decision, in all of them."""
    if not _joined():
        return decision
    said = torch.tensor([decision], dtype=torch.uint8, device="cpu")
    dist.broadcast(said, 0)
    return bool(said)


def rank_zero_first(work: Callable[[], _Result]) -> _Result:
    """Does in all processes what leaves files behind: first in one, then in the others.

    Raises:
        InputError: in the others, if the first failed, which says why itself.
    """
    done = False
    try:
        result = work() if rank() == 0 else None
        done = True
    finally:
        done = agreed(done)
    if rank() == 0:
        return result  # type: ignore[return-value]
    if not done:
        raise InputError("rank 0 failed; see its message")
    return work()


def check_same_step(step: int) -> None:
    """Raises ValueError if not all processes are at the same step of a training."""
    if not _joined():
        return
    steps: list[Any] = [None] * world_size()
    dist.all_gather_object(steps, step)
    if len(set(steps)) > 1:
        raise InputError(
            f"the processes resume at different steps {steps}: --out must be one folder that all "
            "of them see"
        )


def convert_sync_batchnorms(module: nn.Module) -> None:
    """On GPUs, lets batch norms within a module see all processes' samples."""
    if world_size() > 1 and any(p.is_cuda for p in module.parameters()):
        nn.SyncBatchNorm.convert_sync_batchnorm(module)


def in_parallel(module: nn.Module) -> nn.Module:
    """The module with its gradients averaged over the processes."""
    if not _joined():
        return module
    # A batch of one object leaves the other objects' decoders without a gradient.
    return DistributedDataParallel(module, find_unused_parameters=True)


def broadcast_weights(module: nn.Module) -> None:
    """Gives every process the first one's weights and running statistics."""
    if not _joined():
        return
    for tensor in module.state_dict().values():
        shared = tensor.contiguous()
        dist.broadcast(shared, 0)
        tensor.copy_(shared)
