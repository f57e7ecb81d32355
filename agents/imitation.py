"""Trains the network of ``greedy-predicted`` on a bank: every candidate of every scene teaches."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor
from torch.nn import functional as F
from tqdm import tqdm

from ..envs.actions import check_candidates
from ..envs.mirror import Mirror
from ..envs.view_bank import ViewBank
from .greedy import GreedyAgent
from .hyperparameters import GreedyHyperparameters
from .judge import train_judge
from .predictor import ErrorPredictor, crop_spans, view_features

SHIFT = 2
"""Pixels by which a crop is shifted at most in training."""


@dataclass(frozen=True, eq=False)
class Lessons:
    """A bank as the network's inputs and answers.

    Attributes:
        observations: batch of all scenes, images uint8 (M, 3, S, S).
        views: (M, N, 11), see :func:`view_features`.
        errors: min(ADD(-S) / diameter, 1), (M, N); NaN where it is not known.
        visibility: visible fraction of the object, (M, N); NaN where it is not known.
    """

    observations: dict[str, Tensor]
    views: Tensor
    errors: Tensor
    visibility: Tensor

    @classmethod
    def of(
        cls, bank: ViewBank, mirrored: bool = False, device: torch.device = torch.device("cpu")
    ) -> Lessons:
        """Reads a bank, or what it would be in a mirror, onto a device."""
        first = bank.first
        if mirrored:
            first = Mirror(check_candidates(bank.header.candidate_views)).observation(first)
        views = view_features(bank.T_cam_world, bank.centre, bank.second_T_cam_world, mirrored)
        observations = {k: torch.from_numpy(a.copy()).to(device) for k, a in first.items()}
        observations["image"] = observations["image"].permute(0, 3, 1, 2).contiguous()
        return cls(
            observations,
            torch.from_numpy(views).to(device),
            torch.from_numpy(np.minimum(bank.second_error, 1.0).astype(np.float32)).to(device),
            torch.from_numpy(bank.second_visibility.astype(np.float32)).to(device),
        )

    def and_more(self, more: Lessons) -> Lessons:
        """These lessons, then others."""
        keys = self.observations
        return Lessons(
            {key: torch.cat([self.observations[key], more.observations[key]]) for key in keys},
            torch.cat([self.views, more.views]),
            torch.cat([self.errors, more.errors]),
            torch.cat([self.visibility, more.visibility]),
        )

    def batch(self, rows: Tensor) -> tuple[dict[str, Tensor], Tensor]:
        """Observations of some of the scenes, their images 0 to 1, and the views."""
        observations = {key: value[rows] for key, value in self.observations.items()}
        observations["image"] = observations["image"].float() / 255.0
        return observations, self.views[rows]


def train_agent_networks(
    bank: ViewBank,
    observation_space: spaces.Dict,
    hyperparameters: GreedyHyperparameters,
    seed: int,
    progress: bool = True,
    more: ViewBank | None = None,
    device: torch.device = torch.device("cpu"),
) -> GreedyAgent:
    """Trains the networks of one agent; on the processor the same arguments give the same weights.

    There one thread computes: several add up in another order, and networks as small as these
    gain nothing by them.

    Args:
        bank: the scenes to learn from.
        observation_space: images with channels first.
        hyperparameters: see there.
        seed: of first weights, order and augmentation.
        progress: show a bar.
        more: further scenes, which say only what is visible from where.
        device: where to train; all scenes are held there.
    """
    lessons = tuple(Lessons.of(bank, mirrored, device) for mirrored in (False, True))
    if more is not None:
        further = (Lessons.of(more, mirrored, device) for mirrored in (False, True))
        lessons = tuple(a.and_more(b) for a, b in zip(lessons, further, strict=True))
    rng = np.random.default_rng(np.random.SeedSequence([seed, 1]))
    spans = crop_spans(bank.header.diameters)
    forked = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices=forked), _one_thread():
        torch.manual_seed(int(rng.integers(2**31)))
        with torch.device("cpu"):  # first weights are drawn there, whatever trains them
            agent = GreedyAgent(observation_space, hyperparameters, spans)
        agent.to(device)
        total = hyperparameters.epochs * len(agent.networks)
        with tqdm(total=total, unit="epoch", disable=not progress) as bar:
            for network in agent.networks:
                assert isinstance(network, ErrorPredictor)
                for loss in _epochs(network, lessons, hyperparameters, rng):
                    bar.set_postfix(loss=f"{loss:.3f}")
                    bar.update()
        train_judge(agent.judge, bank, rng)
    return agent.eval()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Lets torch use one thread meanwhile."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _epochs(
    network: ErrorPredictor,
    lessons: tuple[Lessons, ...],
    hyperparameters: GreedyHyperparameters,
    rng: np.random.Generator,
) -> Iterator[Tensor]:
    """Trains one network and yields the mean loss of each epoch."""
    h, count = hyperparameters, len(lessons[0].errors)
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=h.learning_rate, weight_decay=h.weight_decay
    )
    batches = -(-count // h.batch_size)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, h.epochs * batches)
    network.train()
    device = network.spans.device
    for _ in range(h.epochs):
        total = torch.zeros((), device=device)  # a number would have every step wait for a GPU
        for rows in np.array_split(rng.permutation(count), batches):
            chosen, at = lessons[int(rng.integers(2))], torch.from_numpy(rows).to(device)
            observations, views = chosen.batch(at)
            observations["image"] = _disturbed(observations["image"], rng)
            error, visible = network(observations, views)
            loss = _known_loss(error, chosen.errors[at])
            loss = loss + _known_loss(visible, chosen.visibility[at])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            total += loss.detach() * len(rows)
        yield total / count


def _known_loss(logits: Tensor, wanted: Tensor) -> Tensor:
    """Cross entropy where it is known what is wanted; 0 where nothing is."""
    known = torch.isfinite(wanted)
    losses = F.binary_cross_entropy_with_logits(
        logits, torch.where(known, wanted, torch.zeros_like(wanted)), reduction="none"
    )
    return (losses * known).sum() / known.sum().clamp(min=1)


def _disturbed(images: Tensor, rng: np.random.Generator) -> Tensor:
    """Crops (B, 3, S, S) shifted a little, brighter or darker, with more contrast or less."""
    shift = rng.integers(-SHIFT, SHIFT + 1, 2).tolist()
    size = (len(images), 1, 1, 1)
    draws = rng.uniform(0.8, 1.2, size), rng.normal(0.0, 0.1, size)
    contrast, brightness = (
        torch.from_numpy(draw.astype(np.float32)).to(images.device) for draw in draws
    )
    return (torch.roll(images, shift, (2, 3)) * contrast + brightness).clamp(0.0, 1.0)


def chosen_slots(agent: GreedyAgent, bank: ViewBank) -> np.ndarray:
    """The slot of least predicted error in every scene of a bank, (M,)."""
    lessons = Lessons.of(bank, device=agent.device)
    observations, views = lessons.batch(torch.arange(len(bank), device=agent.device))
    return agent.predict(observations, views).argmin(axis=1)
