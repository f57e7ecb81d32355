"""Training one set of weights on several processes, started by ``torchrun``.

Each process draws its share of a batch and PyTorch's DistributedDataParallel averages their
gradients (Li et al., "PyTorch Distributed", VLDB 2020). On GPUs batch norms normalize by the whole
batch (SyncBatchNorm). PyTorch has no SyncBatchNorm for CPUs: there each process normalizes by its
own share, and rank 0's running statistics are kept. The detector's loss, a quotient of sums over a
batch, is computed per share on both.

Without ``torchrun`` every function here does nothing, or returns at once.
"""

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
"""Other ranks wait while rank 0 packs data and validates; a rank that ended is noticed at once."""


def rank_device(requested: str) -> torch.device:
    """Returns the device of this process: each rank on a machine takes a GPU of its own.

    Args:
        requested: see :func:`resolve_device`.

    Raises:
        InputError: if there is no such device, or fewer GPUs than ranks.
    """
    device = resolve_device(requested)
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
            f"torchrun started {_local_world_size()} processes on a machine with {gpus} GPUs: "
            f"give --nproc-per-node={gpus}, or --device cpu"
        )
    return torch.device("cuda", number)


@contextlib.contextmanager
def process_group(device: torch.device) -> Iterator[None]:
    """Joins the process group of ``torchrun``; leaves it at the end and on errors.

    Only rank 0 prints: the output of the others would be the same.
    """
    if device.type == "cuda":
        torch.cuda.set_device(device)
    if int(os.environ.get("WORLD_SIZE", "1")) < 2 or "RANK" not in os.environ or _joined():
        yield
        return
    # Communication other than gradients stays on the CPU and does not synchronize with a GPU.
    backend = "cpu:gloo,cuda:nccl" if device.type == "cuda" else "gloo"
    dist.init_process_group(backend, timeout=_TIMEOUT)
    try:
        with contextlib.ExitStack() as stack:
            if rank():
                nothing = stack.enter_context(open(os.devnull, "w"))
                stack.enter_context(contextlib.redirect_stdout(nothing))
            yield
            broadcast_decision(True)  # a rank that ends earlier would look like one that failed
    finally:
        dist.destroy_process_group()


def _joined() -> bool:
    return dist.is_available() and dist.is_initialized()


def rank() -> int:
    """The rank of this process; only rank 0 writes files."""
    return dist.get_rank() if _joined() else 0


def world_size() -> int:
    """The number of processes that train together."""
    return dist.get_world_size() if _joined() else 1


def _local_world_size() -> int:
    """The number of ranks on this machine."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", world_size()))


def threads_per_rank() -> int:
    """This rank's share of the cores, at least 1; ``torchrun`` would set one thread per rank."""
    return max(1, available_cores() // _local_world_size())


def broadcast_decision(decision: bool) -> bool:
    """Returns rank 0's decision on all ranks."""
    if not _joined():
        return decision
    shared = torch.tensor([decision], dtype=torch.uint8, device="cpu")
    dist.broadcast(shared, 0)
    return bool(shared)


def rank_zero_first(work: Callable[[], _Result]) -> _Result:
    """Runs work that leaves files behind on rank 0, then on the other ranks.

    Raises:
        InputError: on the other ranks, if rank 0 failed.
    """
    done = False
    try:
        result = work() if rank() == 0 else None
        done = True
    finally:
        done = broadcast_decision(done)
    if rank() == 0:
        return result  # type: ignore[return-value]
    if not done:
        raise InputError("rank 0 failed; see its message")
    return work()


def check_same_step(step: int) -> None:
    """Raises InputError if the ranks are at different steps of a training."""
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
    """Converts the batch norms within a module to SyncBatchNorm on GPUs."""
    if world_size() > 1 and any(p.is_cuda for p in module.parameters()):
        nn.SyncBatchNorm.convert_sync_batchnorm(module)


def data_parallel(module: nn.Module) -> nn.Module:
    """Wraps a module so that its gradients are averaged over the ranks."""
    if not _joined():
        return module
    # A batch of one object leaves the other objects' decoders without a gradient.
    return DistributedDataParallel(module, find_unused_parameters=True)


def broadcast_weights(module: nn.Module) -> None:
    """Copies rank 0's weights and running statistics to all ranks."""
    if not _joined():
        return
    for tensor in module.state_dict().values():
        shared = tensor.contiguous()
        dist.broadcast(shared, 0)
        tensor.copy_(shared)
