"""Several processes that train one set of weights, started by ``torchrun``.

W processes with B samples each take the step that one process would take with all W * B: the batch
is drawn as there and each process takes its share of it (:func:`own_share`), quotients of sums over
a batch are those of the whole one (:func:`quotient`), batch norms normalise by the whole one
(``global_batch_norm.py``), and the gradients' mean (:func:`average_gradients`) is the gradient.
What is left are the orders of sums: differences of single precision.

Without ``torchrun``, or with one process, every function here does nothing, or the same at once.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta
from typing import TypeVar

import torch
import torch.distributed as dist
from torch import Tensor, nn

from .cores import available_cores

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_PATIENCE = timedelta(days=1)
"""How long processes wait for the first, which packs data and validates while they do; that one of
them ended is noticed at once."""


@contextlib.contextmanager
def process_group() -> Iterator[None]:
    """Joins the processes that ``torchrun`` started, and leaves them in the end, on errors too.

    All but the first print nothing: what they would say is the same.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) < 2 or "RANK" not in os.environ or _joined():
        yield
        return
    dist.init_process_group("gloo", timeout=_PATIENCE)
    try:
        with contextlib.ExitStack() as stack:
            if rank():
                nothing = stack.enter_context(open(os.devnull, "w"))
                stack.enter_context(contextlib.redirect_stdout(nothing))
            yield
            wait()  # a process that ends earlier would look like one that failed
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


def wait() -> None:
    """Until all processes are here."""
    if _joined():
        dist.barrier()


def own_threads() -> int | None:
    """This process's share of the cores, at least 1; None where it is alone.

    ``torchrun`` itself would give each process one thread, however many cores there are.
    """
    if world_size() == 1:
        return None
    return max(1, available_cores() // int(os.environ.get("LOCAL_WORLD_SIZE", world_size())))


def own_share(whole: Sequence[_Item]) -> Sequence[_Item]:
    """This process's part of what is for all: its length is divided by the number of processes."""
    count = len(whole) // world_size()
    return whole[rank() * count : (rank() + 1) * count]


def first_alone(work: Callable[[], _Result]) -> _Result:
    """Does in all processes what leaves files behind: first in one, then in the others.

    Raises:
        ValueError: in the others, if the first failed, which says why itself.
    """
    failed = torch.ones(1)
    try:
        result = work() if rank() == 0 else None
        failed.zero_()
    finally:
        if _joined():
            dist.broadcast(failed, 0)
    if rank() == 0:
        return result  # type: ignore[return-value]
    if failed:
        raise ValueError("the first process failed; its message says why")
    return work()


def quotient(total: Tensor, weight: Tensor, least: float = 1.0) -> Tensor:
    """``total / weight`` of the whole batch, as this process's part of it.

    Args:
        total: a sum over this process's samples.
        weight: the sum of their weights, without gradient.
        least: that the sum of weights over all processes counts as.

    Returns:
        The part; the mean of all processes' parts is the quotient of the whole batch's sums.
    """
    weight = weight.detach().float()
    if _joined():
        weight = weight.clone()
        dist.all_reduce(weight)
    return world_size() * total / weight.clamp(min=least)


def average(tensors: Sequence[Tensor]) -> None:
    """Replaces tensors by their means over the processes, all in one exchange.

    Args:
        tensors: of the same shapes and order in each process; float32.
    """
    if not _joined() or not tensors:
        return
    flat = torch.cat([tensor.detach().reshape(-1) for tensor in tensors])
    dist.all_reduce(flat)
    flat /= world_size()
    parts = flat.split([tensor.numel() for tensor in tensors])
    for tensor, part in zip(tensors, parts, strict=True):
        tensor.detach().copy_(part.view(tensor.shape))


def average_gradients(parameters: Sequence[nn.Parameter], *numbers: Tensor) -> None:
    """Replaces gradients by their means over the processes.

    Args:
        parameters: whose gradients; one without a gradient in some processes counts as zero there,
            and one that has none in any keeps none.
        numbers: further tensors to average with them, in place.
    """
    if not _joined():
        return
    known = torch.tensor([p.grad is not None for p in parameters], dtype=torch.uint8)
    dist.all_reduce(known, dist.ReduceOp.MAX)
    gradients: list[Tensor] = []
    for parameter, anywhere in zip(parameters, known.tolist(), strict=True):
        if anywhere and parameter.grad is None:
            parameter.grad = torch.zeros_like(parameter)
        if parameter.grad is not None:
            gradients.append(parameter.grad)
    average([*gradients, *numbers])


def share_start(module: nn.Module, step: int) -> None:
    """Gives every process the first one's weights.

    Args:
        module: that is trained.
        step: that the training is at.

    Raises:
        ValueError: if not all processes are at the same step.
    """
    if not _joined():
        return
    steps = [torch.zeros(1, dtype=torch.int64) for _ in range(world_size())]
    dist.all_gather(steps, torch.tensor([step]))
    if len({int(other) for other in steps}) > 1:
        raise ValueError(
            f"the processes resume at different steps {[int(other) for other in steps]}: --out "
            "must be one folder that all of them see"
        )
    for tensor in module.state_dict().values():
        shared = tensor.contiguous()
        dist.broadcast(shared, 0)
        tensor.copy_(shared)
