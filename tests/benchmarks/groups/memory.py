"""Growth of memory over many episodes of pixels: training runs millions in one process."""

from __future__ import annotations

import numpy as np
from tqdm import tqdm
from two_view_pose.core.worker_pool import memory_in_use

from ..stopwatch import Record
from .pixels import SIDE, pixels_env

STEPS = 2_000_000
"""Steps to which the growth is extrapolated."""
GOAL = 100.0
"""Megabytes (1e6 bytes) that memory may grow by over ``STEPS``."""
WARM_UP = 0.1
"""Share of the steps that do not count: caches fill, the driver allocates."""
SAMPLES = 200
_SHOWN = 20
"""Samples that are recorded."""


def measure_memory(steps: int, seed: int) -> list[Record]:
    """Plays episodes (a reset and a step each) and fits a line through the memory in use.

    Args:
        steps: how many.
        seed: of the first episode.

    Returns:
        Records of the results file: the growth, and memory along the way.

    Raises:
        ValueError: if there are too few steps to fit a line.
    """
    if steps < 100:
        raise ValueError(f"soak must be at least 100 steps, got {steps}")
    env = pixels_env(seed)
    every = max(1, steps // SAMPLES)
    counts, memory = [], []
    for step in tqdm(range(1, steps + 1), desc="soak", unit="step"):
        env.step(env.action_space.sample())
        env.reset()
        if step % every == 0:
            counts.append(step)
            memory.append(memory_in_use())
    env.close()
    return records(np.array(counts), np.array(memory))


def records(counts: np.ndarray, memory: np.ndarray) -> list[Record]:
    """The growth after the warm-up, and what was measured.

    Memory grows in steps, and in a short run one step of a megabyte is a steep line: so the growth
    in the second half of the run is reported as well.

    Args:
        counts: steps that had been made at each measurement, (N,).
        memory: bytes in use then, (N,).
    """
    late = counts > WARM_UP * counts[-1]
    slope = _slope(counts[late], memory[late])
    second = counts > counts[-1] / 2
    work = f"memory of the pixels env, {SIDE}x{SIDE}"
    growth = {
        "metric": "memory_growth",
        "value": slope * STEPS / 1e6,
        "unit": "MB",
        "work": f"{work}, over {STEPS:,} steps",
        "goal": GOAL,
        "lower_is_better": True,
        "bytes_per_step": slope,
        "second_half": _slope(counts[second], memory[second]) * STEPS / 1e6,
        "first_mb": float(memory[late][0] / 1e6),
        "last_mb": float(memory[-1] / 1e6),
        "highest_mb": float(memory.max() / 1e6),
        "n": int(counts[-1]),
    }
    shown = np.unique(np.linspace(0, len(counts) - 1, _SHOWN).round().astype(int))
    samples = [
        {
            "metric": "memory",
            "value": float(memory[i] / 1e6),
            "unit": "MB",
            "work": work,
            "steps": int(counts[i]),
        }
        for i in shown
    ]
    return [growth, *samples]


def _slope(counts: np.ndarray, memory: np.ndarray) -> float:
    """Bytes a step of the least-squares line."""
    return float(np.polyfit(counts.astype(float), memory.astype(float), 1)[0])
