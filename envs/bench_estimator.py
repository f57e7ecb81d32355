"""The estimator and the environment's step beside networks whose cost everybody knows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from ..pose_estimator import load
from ..pose_estimator.geometry import View
from ..pose_estimator.stopwatch import WARM_UP, Record, make_record, seconds
from .reference_network import PVNet, resnet18

PAIRS = 8
"""Pairs of views that take turns."""


def compare_estimates(weights: str, repeats: int, seed: int) -> Iterator[Record]:
    """Mid-Fusion and a whole step; see the two functions below."""
    yield compare_pair(weights, repeats, seed)
    yield compare_step(weights, repeats, seed)


def compare_pair(weights: str, repeats: int, seed: int) -> Record:
    """A pose from two pictures by Mid-Fusion against one forward pass of PVNet on one picture."""
    estimator = load("mid", weights, device="cpu")
    pairs = draw_pairs(seed, PAIRS)
    forward = forward_pass(PVNet())
    ours, theirs = [], []
    for turn in range(repeats + WARM_UP):
        views, name = pairs[turn % len(pairs)]
        ours.append(seconds(partial(estimator.estimate, anew(views), name)))
        theirs.append(seconds(forward))
    return make_record(
        "Mid-Fusion, one pair, pictures to pose",
        "PVNet forward (ResNet-18 at stride 8, decoder), one picture, 640x480, float32",
        ours[WARM_UP:],
        theirs[WARM_UP:],
        goal=2.0,
    )


def compare_step(weights: str, repeats: int, seed: int) -> Record:
    """A whole ``env.step`` against one forward pass of a ResNet-18 on a 640x480 picture."""
    env = gym.make("TwoViewPose-v0", estimator=load("mid", weights, device="cpu"))
    forward = forward_pass(resnet18())
    rng = np.random.default_rng(seed)
    ours, theirs = [], []
    for repeat in range(repeats + WARM_UP):
        env.reset(seed=seed + repeat)
        action = rng.uniform(-1, 1, env.action_space.shape or ()).astype(np.float32)
        ours.append(seconds(partial(env.step, action)))
        theirs.append(seconds(forward))
    env.close()
    return make_record(
        "env.step: render, detect, estimate, reward",
        "ResNet-18 forward, 640x480, float32",
        ours[WARM_UP:],
        theirs[WARM_UP:],
        goal=1.0,
    )


def draw_pairs(seed: int, count: int) -> list[tuple[tuple[View, ...], str]]:
    """Both views of some episodes with random second views, and whose they are."""
    env = gym.make("TwoViewPose-v0", estimator=None)
    rng = np.random.default_rng(seed)
    pairs = []
    for number in range(count):
        env.reset(seed=seed + number)
        env.step(rng.uniform(-1, 1, env.action_space.shape or ()).astype(np.float32))
        pairs.append((env.get_wrapper_attr("views"), env.get_wrapper_attr("object_name")))
    env.close()
    return pairs


def anew(views: tuple[View, ...]) -> tuple[View, ...]:
    """The same views as others, of which the estimator remembers nothing."""
    return tuple(View(view.image, view.K, view.T_cam_world) for view in views)


def forward_pass(network: torch.nn.Module) -> Callable[[], Any]:
    """What runs a network on one picture of 640x480, in single precision."""
    network.eval()
    picture = torch.zeros(1, 3, 480, 640)

    def forward() -> torch.Tensor:
        with torch.inference_mode():
            return network(picture)

    return forward
