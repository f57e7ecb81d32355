"""A training loop that can be killed at any moment: checkpoints, resume, log, progress bar."""

from __future__ import annotations

import contextlib
import ctypes
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor, nn
from tqdm import tqdm

from .checkpoints import has_checkpoint, load_checkpoint, save_checkpoint
from .distributed import (
    agreed,
    check_same_step,
    in_parallel,
    rank,
    share_weights,
    synchronise_batch_norms,
)
from .optimizer import HybridOptimizer

# Of glibc's malloc.h.
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_MAX = -1, -2, -4


class Stage(Protocol):
    """One thing to train.

    Attributes:
        name: of the checkpoint files.
        module: whose trainable parameters are optimised.
        steps: how many in all.
        learning_rate: its maximum.
    """

    name: str
    steps: int
    learning_rate: float

    @property
    def module(self) -> nn.Module:
        """What is trained."""
        ...

    def batches(self, start: int) -> Iterator[Any]:
        """Batches from number ``start`` to the last at least."""
        ...

    def loss(self, batch: Any) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of a batch, and its parts for the log."""
        ...

    def validate(self) -> dict[str, float]:
        """Numbers on held-out scenes."""
        ...


@dataclass(frozen=True)
class LoopConfig:
    """How the loop runs.

    Attributes:
        out: folder of checkpoints and logs.
        checkpoint_every: seconds between checkpoints.
        validate_every: steps between validations.
        weight_decay: AdamW's.
        warm_up: steps until the full learning rate.
        resume: continue from the last checkpoint of the stage, if there is one.
        deadline: when to stop, by ``time.monotonic()``, after a step at least.
        max_part_mib: largest size of a checkpoint's files; 0: each checkpoint is one file.
        cycles: how often the learning rate falls. The result is the mean of the weights at the end
            of each fall (Izmailov et al., "Averaging weights leads to wider optima", UAI 2018).
    """

    out: Path
    checkpoint_every: float = 120.0
    validate_every: int = 500
    weight_decay: float = 1e-4
    warm_up: int = 200
    resume: bool = True
    deadline: float = math.inf
    max_part_mib: int = 0
    cycles: int = 1


def learning_rate(step: int, steps: int, maximum: float, warm_up: int) -> float:
    """Linear warm-up, then a cosine down to a hundredth."""
    if step < warm_up:
        return maximum * (step + 1) / warm_up
    progress = min(1.0, (step - warm_up) / max(1, steps - warm_up))
    return maximum * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))


def run_stage(stage: Stage, config: LoopConfig, log: Callable[[str, int, dict], None]) -> int:
    """Trains a stage to its last step or the deadline, from where its last checkpoint left off.

    Processes that train together (see ``distributed.py``) end with the same weights; the first
    alone validates, logs and writes checkpoints, which all of them resume from.

    Returns:
        The step that it is at.

    Raises:
        FloatingPointError: if the loss is no longer finite.
    """
    synchronise_batch_norms(stage.module)
    first = rank() == 0
    optimizer = HybridOptimizer(stage.module, stage.learning_rate, config.weight_decay)
    checkpoint = config.out / f"{stage.name}.safetensors"
    mean = _MeanWeights()
    step = _resume(stage, optimizer, mean, checkpoint) if config.resume else 0
    check_same_step(step)
    if step >= stage.steps:
        return step
    batch_loss = in_parallel(_Loss(stage))
    cycle = math.ceil(stage.steps / config.cycles)
    warm_up = min(config.warm_up, cycle // 5 + 1)
    saved = time.monotonic()
    means: dict[str, float] = {}
    late = False
    with (
        contextlib.closing(stage.batches(step)) as source,  # type: ignore[type-var]
        tqdm(
            total=stage.steps, initial=step, desc=stage.name, unit="step", mininterval=5.0,
            disable=not first,
        ) as bar,
    ):  # fmt: skip
        while step < stage.steps and not late:
            begun = step - step % cycle
            length = min(cycle, stage.steps - begun)
            rate = learning_rate(step - begun, length, stage.learning_rate, warm_up)
            parts = _train_step(stage.name, batch_loss, next(source), optimizer, rate, step)
            step += 1
            cycle_ends = config.cycles > 1 and step in (begun + cycle, stage.steps)
            if cycle_ends:
                mean.add(stage.module)
            if cycle_ends and step == stage.steps:
                stage.module.load_state_dict(mean.weights)
            for name, value in parts.items():
                means[name] = 0.98 * means.get(name, value) + 0.02 * value
            bar.update(1)
            if step % 20 == 0:
                bar.set_postfix({name: f"{value:.4f}" for name, value in means.items()})
            if first and step % 100 == 0:
                log(stage.name, step, {f"train/{name}": value for name, value in means.items()})
            if first and (step % config.validate_every == 0 or step == stage.steps):
                _validate(stage, step, log)
            due = time.monotonic() - saved > config.checkpoint_every
            late = config.deadline < math.inf and agreed(time.monotonic() > config.deadline)
            if first and (due or late or cycle_ends or step == stage.steps):
                _save(stage, optimizer, mean, checkpoint, step, config.max_part_mib)
                saved = time.monotonic()
    share_weights(stage.module)  # running statistics may have been each process's own
    return step


class _Loss(nn.Module):
    """A stage's loss as a module, whose gradients DistributedDataParallel can average."""

    def __init__(self, stage: Stage):
        super().__init__()
        self.module = stage.module
        self._loss = stage.loss

    def forward(self, batch: Any) -> tuple[Tensor, dict[str, Tensor]]:
        loss, parts = self._loss(batch)
        return loss, {name: part.detach() for name, part in parts.items()}


def _train_step(
    name: str, batch_loss: nn.Module, batch: Any, optimizer: HybridOptimizer, rate: float, step: int
) -> dict[str, float]:
    """One step down the loss of a batch; returns the loss's parts."""
    loss, parts = batch_loss(batch)
    optimizer.zero_grad()
    loss.backward()
    norm = nn.utils.clip_grad_norm_(optimizer.parameters, 5.0)
    # Read all at once: a GPU is waited for once a step.
    length, value, *values = torch.stack([norm, loss.detach(), *parts.values()]).tolist()
    if not math.isfinite(length):
        raise FloatingPointError(
            f"{name}: the loss is {value} at step {step}; resume with a lower --learning-rate"
        )
    optimizer.step(rate)
    return dict(zip(parts, values, strict=True))


def _validate(stage: Stage, step: int, log: Callable[[str, int, dict], None]) -> None:
    numbers = stage.validate()
    log(stage.name, step, {f"held_out/{name}": value for name, value in numbers.items()})
    text = "  ".join(f"{name} {value:.4f}" for name, value in numbers.items())
    tqdm.write(f"{stage.name} step {step}: {text}")


class _MeanWeights:
    """The mean of weights at several moments, and of how many.

    Attributes:
        weights: by name; empty before the first.
        count: how many they are the mean of.
    """

    def __init__(self) -> None:
        self.weights: dict[str, Tensor] = {}
        self.count = 0

    def add(self, module: nn.Module) -> None:
        """Takes the weights of now into the mean; whole numbers are the newest."""
        self.count += 1
        for name, tensor in module.state_dict().items():
            if self.count > 1 and tensor.is_floating_point():
                self.weights[name] += (tensor - self.weights[name]) / self.count
            else:
                self.weights[name] = tensor.clone()


def keep_freed_memory() -> None:
    """Tells glibc to keep what is freed for the next step, instead of returning it to the system.

    Every step allocates the same large buffers; mapping them anew each time cost a fifth of a
    training's time on two cores. Elsewhere than on glibc this does nothing.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
        mallopt(_M_TOP_PAD, 2**28)


def _save(
    stage: Stage, optimizer: HybridOptimizer, mean: _MeanWeights, path: Path, step: int,
    part_mib: int,
) -> None:  # fmt: skip
    tensors = {f"model.{n}": t.contiguous() for n, t in stage.module.state_dict().items()}
    tensors |= {f"mean.{n}": t.contiguous() for n, t in mean.weights.items()}
    tensors |= optimizer.state()
    numbers = {"step": step, "steps": stage.steps, "averaged": mean.count}
    save_checkpoint(path, tensors, numbers, part_mib)


def _resume(stage: Stage, optimizer: HybridOptimizer, mean: _MeanWeights, path: Path) -> int:
    """Restores a checkpoint and returns its step; 0 if there is none."""
    if not has_checkpoint(path):
        return 0
    tensors, numbers = restore_model(stage.module, path)
    optimizer.load_state(tensors)
    device = next(stage.module.parameters()).device
    mean.weights = {
        name.removeprefix("mean."): tensor.to(device)
        for name, tensor in tensors.items()
        if name.startswith("mean.")
    }
    mean.count = numbers.get("averaged", 0)
    return numbers["step"]


def restore_model(module: nn.Module, path: Path) -> tuple[dict[str, Tensor], dict[str, int]]:
    """Loads a checkpoint's parameters into a stage's module; returns all that the file holds.

    Raises:
        ValueError: if it is of networks of another shape.
    """
    tensors, numbers = load_checkpoint(path)
    state = {n.removeprefix("model."): t for n, t in tensors.items() if n.startswith("model.")}
    try:
        module.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(
            f"checkpoint {path} is of networks of another shape; give another --out, or delete it"
        ) from error
    return tensors, numbers
