"""Supervised training of the networks of ``greedy`` on a bank; nothing is imitated.

Error regression: the bank knows the error and the visibility after every candidate view of every
scene, and networks learn to predict them. Success classification: the bank knows the estimate after
every view and whether it was right, and a small network learns to predict it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn
from torch.nn import functional as F
from tqdm import tqdm

from ...envs.actions import check_candidates
from ...envs.view_banks.bank import ViewBank
from ...envs.view_banks.mirror import Mirror
from ..networks.algorithms import GreedyHyperparameters
from ..networks.predictor import ErrorPredictor, crop_widths, view_features
from ..networks.success_classifier import SuccessClassifier, success_features
from ..policies.greedy import GreedyAgent

MAX_SHIFT = 2
"""Pixels by which a crop is shifted at most in training."""


@dataclass(frozen=True, eq=False)
class ErrorDataset:
    """A bank as the network's inputs and targets.

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
    ) -> ErrorDataset:
        """Reads a bank, or what it would be in a mirror, onto a device."""
        first = bank.first
        if mirrored:
            first = Mirror(check_candidates(bank.header.candidate_views)).observation(first)
        views = view_features(bank.T_cam_world, bank.center, bank.second_T_cam_world, mirrored)
        observations = {k: torch.from_numpy(a.copy()).to(device) for k, a in first.items()}
        observations["image"] = observations["image"].permute(0, 3, 1, 2).contiguous()
        return cls(
            observations,
            torch.from_numpy(views).to(device),
            torch.from_numpy(np.minimum(bank.second_error, 1.0).astype(np.float32)).to(device),
            torch.from_numpy(bank.second_visibility.astype(np.float32)).to(device),
        )

    def concatenate(self, other: ErrorDataset) -> ErrorDataset:
        """This dataset, then another."""
        keys = self.observations
        return ErrorDataset(
            {key: torch.cat([self.observations[key], other.observations[key]]) for key in keys},
            torch.cat([self.views, other.views]),
            torch.cat([self.errors, other.errors]),
            torch.cat([self.visibility, other.visibility]),
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
    visibility_bank: ViewBank | None = None,
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
        visibility_bank: further scenes, of which only visibilities are known.
        device: where to train; all scenes are held there.
    """
    datasets = [ErrorDataset.of(bank, mirrored, device) for mirrored in (False, True)]
    if visibility_bank is not None:
        datasets = [
            dataset.concatenate(ErrorDataset.of(visibility_bank, mirrored, device))
            for dataset, mirrored in zip(datasets, (False, True), strict=True)
        ]
    rng = np.random.default_rng(np.random.SeedSequence([seed, 1]))
    forked = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices=forked), _one_thread():
        torch.manual_seed(int(rng.integers(2**31)))
        with torch.device("cpu"):  # first weights are drawn there, whatever trains them
            agent = GreedyAgent(
                observation_space, hyperparameters, crop_widths(bank.header.diameters)
            )
        agent.to(device)
        total = hyperparameters.epochs * len(agent.networks)
        with tqdm(total=total, unit="epoch", disable=not progress) as bar:
            for network in agent.networks:
                assert isinstance(network, ErrorPredictor)
                for loss in train_error_predictor(network, datasets, hyperparameters, rng):
                    if progress:
                        bar.set_postfix(loss=f"{loss:.3f}")
                    bar.update()
        train_success_classifier(agent.judge, bank, rng)
    return agent.eval()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limits torch to one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def train_error_predictor(
    network: ErrorPredictor,
    datasets: Sequence[ErrorDataset],
    hyperparameters: GreedyHyperparameters,
    rng: np.random.Generator,
) -> Iterator[Tensor]:
    """Trains one network, each batch from one of the datasets; yields each epoch's mean loss."""

    def batch_loss(rows: Tensor) -> Tensor:
        dataset = datasets[int(rng.integers(len(datasets)))]
        observations, views = dataset.batch(rows)
        observations["image"] = augment(observations["image"], rng)
        error, visible = network(observations, views)
        loss = _masked_loss(error, dataset.errors[rows])
        return loss + _masked_loss(visible, dataset.visibility[rows])

    return _fit(network, len(datasets[0].errors), batch_loss, hyperparameters, rng)


def train_success_classifier(
    classifier: SuccessClassifier, bank: ViewBank, rng: np.random.Generator
) -> None:
    """Trains a classifier on every estimate of a bank; ``rng`` draws the order."""
    device = next(classifier.parameters()).device
    features, right = (tensor.to(device) for tensor in _labeled_estimates(bank))

    def batch_loss(rows: Tensor) -> Tensor:
        return F.binary_cross_entropy_with_logits(classifier(features[rows]), right[rows])

    hyperparameters = GreedyHyperparameters(epochs=10, batch_size=256)
    for _ in _fit(classifier, len(right), batch_loss, hyperparameters, rng):
        pass
    classifier.eval()


def _fit(
    network: nn.Module,
    count: int,
    batch_loss: Callable[[Tensor], Tensor],
    hyperparameters: GreedyHyperparameters,
    rng: np.random.Generator,
) -> Iterator[Tensor]:
    """Trains on ``count`` rows by the loss of those of a batch; yields each epoch's mean loss."""
    h, device = hyperparameters, next(network.parameters()).device
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=h.learning_rate, weight_decay=h.weight_decay
    )
    batches = -(-count // h.batch_size)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, h.epochs * batches)
    network.train()
    for _ in range(h.epochs):
        total = torch.zeros((), device=device)  # a number would have every step wait for a GPU
        for rows in np.array_split(rng.permutation(count), batches):
            loss = batch_loss(torch.from_numpy(rows).to(device))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            total += loss.detach() * len(rows)
        yield total / count


def _masked_loss(logits: Tensor, target: Tensor) -> Tensor:
    """Cross entropy where the target is known (not NaN); 0 where none is."""
    known = torch.isfinite(target)
    losses = F.binary_cross_entropy_with_logits(
        logits, torch.where(known, target, torch.zeros_like(target)), reduction="none"
    )
    return (losses * known).sum() / known.sum().clamp(min=1)


def augment(images: Tensor, rng: np.random.Generator) -> Tensor:
    """Crops (B, 3, S, S) shifted a little, brighter or darker, with more contrast or less."""
    shift = rng.integers(-MAX_SHIFT, MAX_SHIFT + 1, 2).tolist()
    size = (len(images), 1, 1, 1)
    draws = rng.uniform(0.8, 1.2, size), rng.normal(0.0, 0.1, size)
    contrast, brightness = (
        torch.from_numpy(draw.astype(np.float32)).to(images.device) for draw in draws
    )
    return (torch.roll(images, shift, (2, 3)) * contrast + brightness).clamp(0.0, 1.0)


def _labeled_estimates(bank: ViewBank) -> tuple[Tensor, Tensor]:
    """Features of every estimate of a bank (M * (N + 1), F), and whether each is right."""
    first = {
        key: np.repeat(array[:, None], bank.slots, axis=1)
        for key, array in bank.first.items()
        if key != "image"
    }
    second = dict(bank.second) | {"object": first["object"]}
    pairs = success_features(first, second).reshape(len(bank) * bank.slots, -1)
    alone = success_features(bank.first, bank.first)
    features = torch.from_numpy(np.concatenate([pairs, alone]))
    right = np.concatenate([(bank.second_error < 0.1).ravel(), bank.first_error < 0.1])
    return features, torch.from_numpy(right.astype(np.float32))


def chosen_slots(agent: GreedyAgent, bank: ViewBank) -> np.ndarray:
    """The slot of least predicted error in every scene of a bank, (M,)."""
    dataset = ErrorDataset.of(bank, device=agent.device)
    observations, views = dataset.batch(torch.arange(len(bank), device=agent.device))
    return agent.predict(observations, views).argmin(axis=1)
