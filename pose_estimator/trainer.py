"""A training loop that can be killed at any moment: checkpoints, resume, log, progress bar."""

from __future__ import annotations

import ctypes
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from safetensors.torch import load_file, save
from torch import Tensor, nn
from tqdm import tqdm

from .data_parallel import average_gradients, rank, share_start
from .global_batch_norm import synchronise_batch_norms
from .optimizer import HybridOptimizer
from .results import write_atomically

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
        """Endless batches from number ``start`` on."""
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
        cycles: how often the learning rate falls. The result is the mean of the weights at the end
            of each fall (Izmailov et al., "Averaging weights leads to wider optima", UAI 2018).
    """

    out: Path
    checkpoint_every: float = 120.0
    validate_every: int = 500
    weight_decay: float = 1e-4
    warm_up: int = 200
    resume: bool = True
    cycles: int = 1


def learning_rate(step: int, steps: int, maximum: float, warm_up: int) -> float:
    """Linear warm-up, then a cosine down to a hundredth."""
    if step < warm_up:
        return maximum * (step + 1) / warm_up
    progress = min(1.0, (step - warm_up) / max(1, steps - warm_up))
    return maximum * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))


def run_stage(stage: Stage, config: LoopConfig, log: Callable[[str, int, dict], None]) -> None:
    """Trains a stage to its last step, from where its last checkpoint left off.

    Processes that train together (see ``data_parallel.py``) end with the same weights; the first
    alone validates, logs and writes checkpoints, which all of them resume from.

    Raises:
        FloatingPointError: if the loss is no longer finite.
    """
    synchronise_batch_norms(stage.module)
    first = rank() == 0
    optimizer = HybridOptimizer(stage.module, stage.learning_rate, config.weight_decay)
    checkpoint = config.out / f"{stage.name}.safetensors"
    mean = _MeanWeights()
    step = _resume(stage, optimizer, mean, checkpoint) if config.resume else 0
    share_start(stage.module, step)
    if step >= stage.steps:
        return
    cycle = math.ceil(stage.steps / config.cycles)
    warm_up = min(config.warm_up, cycle // 5 + 1)
    saved = time.monotonic()
    means: dict[str, float] = {}
    source = stage.batches(step)
    with tqdm(
        total=stage.steps, initial=step, desc=stage.name, unit="step", mininterval=5.0,
        disable=not first,
    ) as bar:  # fmt: skip
        while step < stage.steps:
            loss, parts = stage.loss(next(source))
            optimizer.zero_grad()
            loss.backward()
            loss, parts = loss.detach(), {name: part.detach() for name, part in parts.items()}
            average_gradients(optimizer.parameters, loss, *parts.values())
            norm = nn.utils.clip_grad_norm_(optimizer.parameters, 5.0)
            if not torch.isfinite(norm):
                raise FloatingPointError(
                    f"{stage.name}: the loss is {float(loss)} at step {step}; "
                    "resume with a lower --learning-rate"
                )
            begun = step - step % cycle
            length = min(cycle, stage.steps - begun)
            optimizer.step(learning_rate(step - begun, length, stage.learning_rate, warm_up))
            step += 1
            cycle_ends = config.cycles > 1 and step in (begun + cycle, stage.steps)
            if cycle_ends:
                mean.add(stage.module)
            if cycle_ends and step == stage.steps:
                stage.module.load_state_dict(mean.weights)
            for name, part in parts.items():
                value = float(part)
                means[name] = 0.98 * means.get(name, value) + 0.02 * value
            bar.update(1)
            if step % 20 == 0:
                bar.set_postfix({name: f"{value:.4f}" for name, value in means.items()})
            if first and step % 100 == 0:
                log(stage.name, step, {f"train/{name}": value for name, value in means.items()})
            if first and (step % config.validate_every == 0 or step == stage.steps):
                numbers = stage.validate()
                log(stage.name, step, {f"held_out/{name}": v for name, v in numbers.items()})
                text = "  ".join(f"{name} {value:.4f}" for name, value in numbers.items())
                tqdm.write(f"{stage.name} step {step}: {text}")
            due = time.monotonic() - saved > config.checkpoint_every
            if first and (due or cycle_ends or step == stage.steps):
                _save(stage, optimizer, mean, checkpoint, step)
                saved = time.monotonic()
    getattr(source, "close", lambda: None)()


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
    stage: Stage, optimizer: HybridOptimizer, mean: _MeanWeights, path: Path, step: int
) -> None:
    tensors = {f"model.{n}": t.contiguous() for n, t in stage.module.state_dict().items()}
    tensors |= {f"mean.{n}": t.contiguous() for n, t in mean.weights.items()}
    tensors |= optimizer.state()
    numbers = {"step": step, "steps": stage.steps, "averaged": mean.count}
    write_atomically(path, save(tensors, {name: str(n) for name, n in numbers.items()}))


def _resume(stage: Stage, optimizer: HybridOptimizer, mean: _MeanWeights, path: Path) -> int:
    """Restores a checkpoint and returns its step; 0 if there is none."""
    if not path.is_file():
        return 0
    tensors = restore_model(stage.module, path)
    optimizer.load_state(tensors)
    mean.weights = {n.removeprefix("mean."): t for n, t in tensors.items() if n[:5] == "mean."}
    mean.count = _read_number(path, "averaged")
    return read_step(path)


def restore_model(module: nn.Module, path: Path) -> dict[str, Tensor]:
    """Loads a checkpoint's parameters into a stage's module; returns all that the file holds.

    Raises:
        ValueError: if it is of networks of another shape.
    """
    tensors = load_file(path)
    state = {n.removeprefix("model."): t for n, t in tensors.items() if n.startswith("model.")}
    try:
        module.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(
            f"checkpoint {path} is of networks of another shape; give another --out, or delete it"
        ) from error
    return tensors


def read_step(path: Path) -> int:
    """The step of a checkpoint."""
    return _read_number(path, "step")


def _read_number(path: Path, name: str) -> int:
    """A number of a checkpoint's header; 0 if it is not there."""
    with open(path, "rb") as file:
        length = int.from_bytes(file.read(8), "little")
        return int(json.loads(file.read(length))["__metadata__"].get(name, 0))
