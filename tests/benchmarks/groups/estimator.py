"""The estimator and the environment's step compared with networks of well-known cost."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count, cycle
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from two_view_pose.core.geometry import View

from ..config import BenchConfig
from ..stopwatch import Record, ratio
from .reference_network import PVNet, resnet18

PAIRS = 8
"""Pairs of views that take turns."""


def measure(config: BenchConfig) -> Iterator[Record]:
    """Mid-Fusion and a whole step; see the two functions below."""
    yield compare_pair(config)
    yield compare_step(config)


def compare_pair(config: BenchConfig) -> Record:
    """A pose from two images by Mid-Fusion against one forward pass of PVNet on one image."""
    pairs = cycle(draw_pairs(config.seed, PAIRS))
    return ratio(
        "Mid-Fusion, one pair, images to pose",
        "PVNet forward (ResNet-18 at stride 8, decoder), one image, 640x480, float32",
        config.load_default().estimate,
        forward_pass(PVNet()),
        config.repeats,
        goal=2.0,
        prepare=lambda: fresh_views(*next(pairs)),
    )


def compare_step(config: BenchConfig) -> Record:
    """A whole ``env.step`` against one forward pass of a ResNet-18 on a 640x480 image."""
    env = gym.make("two_view_pose:TwoViewPose-v0", estimator=config.load_default())
    rng, seeds = np.random.default_rng(config.seed), count(config.seed)

    def begin() -> tuple[np.ndarray]:
        env.reset(seed=next(seeds))
        return (draw_action(env, rng),)

    record = ratio(
        "env.step: render, detect, estimate, reward",
        "ResNet-18 forward, 640x480, float32",
        env.step,
        forward_pass(resnet18()),
        config.repeats,
        goal=1.0,
        prepare=begin,
    )
    env.close()
    return record


def draw_pairs(seed: int, count: int) -> list[tuple[tuple[View, ...], str]]:
    """Both views of some episodes with random second views, and the name of their object."""
    env = gym.make("two_view_pose:TwoViewPose-v0", estimator=None)
    rng = np.random.default_rng(seed)
    pairs = []
    for number in range(count):
        env.reset(seed=seed + number)
        env.step(draw_action(env, rng))
        pairs.append((env.get_wrapper_attr("views"), env.get_wrapper_attr("object_name")))
    env.close()
    return pairs


def draw_action(env: gym.Env, rng: np.random.Generator) -> np.ndarray:
    """A random action of an environment with a box of actions within -1 and 1."""
    return rng.uniform(-1, 1, env.action_space.shape or ()).astype(np.float32)


def fresh_views(views: tuple[View, ...], name: str) -> tuple[tuple[View, ...], str]:
    """The same views as new instances, for which the estimator has cached nothing."""
    return tuple(View(view.image, view.K, view.T_cam_world) for view in views), name


def forward_pass(network: torch.nn.Module) -> Callable[[], Any]:
    """Returns a function that runs a network on one image of 640x480, in single precision."""
    network.eval()
    image = torch.zeros(1, 3, 480, 640)

    def forward() -> torch.Tensor:
        with torch.inference_mode():
            return network(image)

    return forward
