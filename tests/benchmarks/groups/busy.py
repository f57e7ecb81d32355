"""The same work alone and next to busy processes, two per core."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import cycle
from typing import Any

import gymnasium as gym
import torch
from two_view_pose.core.cpu_cores import available_cores
from two_view_pose.pose_estimator.networks.features import FeatureConfig, KeypointNet

from ..config import BenchConfig
from ..stopwatch import WARM_UP, Record, make_record, seconds
from .estimator import PAIRS, draw_pairs, fresh_views
from .vector import NUM_ENVS

GOAL = 0.25
"""Four times as long is acceptable; a fair share of the cores would be a third."""

CROPS = 8
"""Crops in the batch of the training step."""

_BUSY = """
import os, sys
print(flush=True)
while os.getppid() == int(sys.argv[1]):
    for _ in range(100_000):
        pass
"""


def measure(config: BenchConfig) -> Iterator[Record]:
    """An estimate, a step of the vector environment and one of training."""
    estimator = config.load_default()
    pairs = cycle(draw_pairs(config.seed, PAIRS))
    yield compare(
        "Mid-Fusion, one pair",
        lambda: estimator.estimate(*fresh_views(*next(pairs))),
        config.repeats,
    )
    envs = gym.make_vec("two_view_pose:TwoViewPose-v0", num_envs=NUM_ENVS, estimator=estimator)
    envs.action_space.seed(config.seed)
    try:
        envs.reset(seed=config.seed)
        yield compare(
            f"vector env, a step of {NUM_ENVS} sub-environments with mid-pnp",
            lambda: envs.step(envs.action_space.sample()),
            config.fewer_repeats,
        )
    finally:
        envs.close()
    work = f"features network, a training step of {CROPS} crops"
    yield compare(work, training_step(), config.fewer_repeats)


def compare(work: str, function: Callable[[], Any], repeats: int) -> Record:
    """Times a call alone and next to busy processes, in turn."""
    count = 2 * available_cores()
    alone, busy = [], []
    for _ in range(WARM_UP):
        function()
    for _ in range(repeats):
        alone.append(seconds(function))
        with busy_processes(count):
            busy.append(seconds(function))
    return make_record(f"{work}, with {count} busy processes", "the same alone", busy, alone, GOAL)


@contextmanager
def busy_processes(count: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Runs busy processes until the block or this process ends."""
    command = [sys.executable, "-I", "-S", "-c", _BUSY, str(os.getpid())]
    running: list[subprocess.Popen[bytes]] = []
    try:
        for _ in range(count):
            running.append(subprocess.Popen(command, stdout=subprocess.PIPE))
        for process in running:
            assert process.stdout is not None
            process.stdout.readline()  # it has begun
        yield running
    finally:
        for process in running:
            process.kill()
        for process in running:
            process.communicate()


def training_step() -> Callable[[], None]:
    """Forward and backward of the features network in training mode, and the optimizer's step."""
    torch.manual_seed(0)
    config = FeatureConfig()
    network = KeypointNet(1, config).train().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(network.parameters(), 1e-4)
    crops = 255 * torch.rand(CROPS, 3, config.crop, config.crop)
    objects = torch.zeros(CROPS, dtype=torch.long)

    def step() -> None:
        optimizer.zero_grad()
        outputs = network(crops.contiguous(memory_format=torch.channels_last), objects)
        torch.stack([output.float().square().mean() for output in outputs]).sum().backward()
        optimizer.step()

    return step
