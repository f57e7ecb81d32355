"""The training loop of a stage: checkpoints, resuming, log, progress bar."""

from __future__ import annotations

import contextlib
import ctypes
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn
from tqdm import tqdm

from .checkpoints import load_checkpoint, read_counters, save_checkpoint
from .distributed import (
    broadcast_decision,
    broadcast_weights,
    check_same_step,
    convert_sync_batchnorms,
    data_parallel,
    rank,
)
from .optimizer import HybridOptimizer

if TYPE_CHECKING:
    from .stage_base import StageBase

_WARM_UP = 200
"""Maximum number of warm-up steps."""

# Of glibc's malloc.h.
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_MAX = -1, -2, -4

Log = Callable[[str, int, dict[str, float]], None]
"""Takes a stage's name, a step, and values by name."""


@dataclass(frozen=True)
class LoopConfig:
    """Options of the loop.

    Attributes:
        out: folder of checkpoints.
        checkpoint_every: seconds between checkpoints.
        validate_every: steps between validations.
        resume: resume from the stage's checkpoint, if there is one.
        deadline: when to stop, by ``time.monotonic()``, after at least one step.
        lr_cycles: cosine cycles of the learning rate. The weights at the ends of the cycles are
            averaged (stochastic weight averaging: Izmailov et al., "Averaging weights
            leads to wider optima", UAI 2018).
    """

    out: Path
    checkpoint_every: float = 120.0
    validate_every: int = 500
    resume: bool = True
    deadline: float = math.inf
    lr_cycles: int = 1


def learning_rate(step: int, steps: int, maximum: float, cycles: int = 1) -> float:
    """Cosine annealing to a hundredth with warm restarts and a linear warm-up in each cycle.

    Loshchilov and Hutter, "SGDR: Stochastic gradient descent with warm restarts", ICLR 2017.

    Args:
        step: from 0 to ``steps`` - 1.
        steps: in all cycles.
        maximum: at the end of the warm-up.
        cycles: of equal length; the last may be shorter.
    """
    cycle = math.ceil(steps / cycles)
    warm_up = min(_WARM_UP, cycle // 5 + 1)
    begin, step = step - step % cycle, step % cycle
    if step < warm_up:
        return maximum * (step + 1) / warm_up
    progress = (step - warm_up) / max(1, min(cycle, steps - begin) - warm_up)
    return maximum * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))


def run_stage(stage: StageBase, config: LoopConfig, log: Log) -> int:
    """Trains a stage from its checkpoint to its last step or the deadline.

    All ranks (see ``distributed.py``) end with the same weights. Only rank 0 validates, logs and
    writes checkpoints, which all of them resume from.

    Returns:
        The step that it has reached.

    Raises:
        FloatingPointError: if the gradient is not finite.
    """
    convert_sync_batchnorms(stage.module)
    run = _Run(stage, config, log)
    check_same_step(run.step)
    if run.step < stage.steps:
        run.train()
        broadcast_weights(stage.module)  # running statistics may differ between ranks
    return run.step


class _Run:
    """The state of a training, which a checkpoint keeps.

    Attributes:
        step: completed steps.
        averaged: the mean of the weights at the ends of cycles, by name; empty before the first.
        cycles: completed cycles.
    """

    def __init__(self, stage: StageBase, config: LoopConfig, log: Log):
        self.stage, self.config, self.log = stage, config, log
        self.optimizer = HybridOptimizer(stage.module, stage.learning_rate)
        self.averaged: dict[str, Tensor] = {}
        self.step = self.cycles = 0
        self._path = config.out / f"{stage.name}.safetensors"
        if config.resume and self._path.is_file():
            self._resume()
        self._saved = time.monotonic()
        self._smoothed: dict[str, float] = {}

    def train(self) -> None:
        """Trains to the last step or the deadline."""
        stage, config, is_main = self.stage, self.config, rank() == 0
        batch_loss = data_parallel(StageLoss(stage))
        late = False
        with (
            contextlib.closing(stage.batches(self.step)) as source,
            tqdm(
                total=stage.steps, initial=self.step, desc=stage.name, unit="step",
                mininterval=5.0, disable=not is_main,
            ) as bar,
        ):  # fmt: skip
            while self.step < stage.steps and not late:
                self._optimize(batch_loss, next(source))
                bar.update(1)
                if self.step % 20 == 0:
                    bar.set_postfix({name: f"{v:.4f}" for name, v in self._smoothed.items()})
                cycle_ends = self._average_weights()
                if is_main:
                    self._report()
                late = config.deadline < math.inf and broadcast_decision(
                    time.monotonic() > config.deadline
                )
                due = time.monotonic() - self._saved > config.checkpoint_every
                if is_main and (due or late or cycle_ends or self.step == stage.steps):
                    self._save()

    def _optimize(self, batch_loss: nn.Module, batch: Any) -> None:
        """Takes one optimizer step."""
        loss, terms = batch_loss(batch)
        self.optimizer.zero_grad()
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.optimizer.parameters, 5.0)
        # One transfer, so that a GPU synchronizes once per step.
        norm, value, *values = torch.stack([norm, loss.detach(), *terms.values()]).tolist()
        if not math.isfinite(norm):
            raise FloatingPointError(
                f"{self.stage.name}: the loss is {value} at step {self.step}; "
                "resume with a lower --learning-rate"
            )
        stage = self.stage
        self.optimizer.step(
            learning_rate(self.step, stage.steps, stage.learning_rate, self.config.lr_cycles)
        )
        self.step += 1
        for name, value in zip(terms, values, strict=True):
            self._smoothed[name] = 0.98 * self._smoothed.get(name, value) + 0.02 * value

    def _average_weights(self) -> bool:
        """Updates the averaged weights if a cycle ends, and loads them after the last one."""
        steps, cycles = self.stage.steps, self.config.lr_cycles
        if cycles == 1 or (self.step % math.ceil(steps / cycles) and self.step < steps):
            return False
        self.cycles += 1
        for name, tensor in self.stage.module.state_dict().items():
            if self.cycles > 1 and tensor.is_floating_point():
                self.averaged[name] += (tensor - self.averaged[name]) / self.cycles
            else:
                self.averaged[name] = tensor.clone()
        if self.step == steps:
            self.stage.module.load_state_dict(self.averaged)
        return True

    def _report(self) -> None:
        """Logs the loss every 100 steps, and validates when it is due."""
        stage, step = self.stage, self.step
        if step % 100 == 0:
            self.log(stage.name, step, {f"train/{n}": v for n, v in self._smoothed.items()})
        if step % self.config.validate_every == 0 or step == stage.steps:
            metrics = stage.validate()
            self.log(stage.name, step, {f"held_out/{n}": v for n, v in metrics.items()})
            text = "  ".join(f"{name} {value:.4f}" for name, value in metrics.items())
            tqdm.write(f"{stage.name} step {step}: {text}")

    def _save(self) -> None:
        averaged = {f"mean.{name}": tensor for name, tensor in self.averaged.items()}
        counters = {"step": self.step, "steps": self.stage.steps, "averaged": self.cycles}
        state = averaged | self.optimizer.state()
        save_checkpoint(self._path, self.stage.module, state, counters)
        self._saved = time.monotonic()

    def _resume(self) -> None:
        state = load_checkpoint(self.stage.module, self._path)
        self.optimizer.load_state(state)
        device = next(self.stage.module.parameters()).device
        self.averaged = {
            name.removeprefix("mean."): tensor.to(device)
            for name, tensor in state.items()
            if name.startswith("mean.")
        }
        counters = read_counters(self._path, "averaged")
        self.step, self.cycles = counters["step"], counters["averaged"]


class StageLoss(nn.Module):
    """A stage's loss as a module, as DistributedDataParallel needs it."""

    def __init__(self, stage: StageBase):
        super().__init__()
        self.module = stage.module
        self._loss = stage.loss

    def forward(self, batch: Any) -> tuple[Tensor, dict[str, Tensor]]:
        loss, terms = self._loss(batch)
        return loss, {name: term.detach() for name, term in terms.items()}


def disable_malloc_trim() -> None:
    """Makes glibc keep freed memory for the next step instead of returning it to the system.

    Every step allocates the same large buffers; mapping them again took a fifth of the training
    time on two cores. Does nothing without glibc.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
        mallopt(_M_TOP_PAD, 2**28)
