"""Supervised training of the networks of ``greedy`` on a bank.

Error regression: networks learn to predict the error and the visibility of every candidate view of
every scene. Success classification: a small network learns whether an estimate is correct.
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
"""Augmentation shifts crops by up to this many pixels."""


@dataclass(frozen=True, eq=False)
class ErrorDataset:
    """Inputs and targets of the error predictor.

    Attributes:
        observations: batch of all scenes, images uint8 (M, 3, S, S).
        views: (M, N, 11), see :func:`view_features`.
        errors: min(ADD(-S) / diameter, 1), (M, N); NaN if unknown.
        visibility: visible fraction of the object, (M, N); NaN if unknown.
    """

    observations: dict[str, Tensor]
    views: Tensor
    errors: Tensor
    visibility: Tensor

    @classmethod
    def from_bank(
        cls, bank: ViewBank, mirrored: bool = False, device: torch.device = torch.device("cpu")
    ) -> ErrorDataset:
        """Copies a bank, or its mirror image, to a device."""
        first = bank.first
        if mirrored:
            first = Mirror(check_candidates(bank.header.candidate_views)).observation(first)
        views = view_features(bank.T_cam_world, bank.center, bank.second_T_cam_world, mirrored)
        observations = {k: torch.from_numpy(a.copy()).to(device) for k, a in first.items()}
        observations["image"] = observations["image"].permute(0, 3, 1, 2).contiguous()
        targets = np.minimum(bank.second_error, 1.0), bank.second_visibility
        arrays = (views, *(target.astype(np.float32) for target in targets))
        return cls(observations, *(torch.from_numpy(array).to(device) for array in arrays))

    def concatenate(self, other: ErrorDataset) -> ErrorDataset:
        """Appends another dataset."""
        names = ("views", "errors", "visibility")
        pairs = {key: (value, other.observations[key]) for key, value in self.observations.items()}
        return ErrorDataset(
            {key: torch.cat(pair) for key, pair in pairs.items()},
            *(torch.cat([getattr(self, name), getattr(other, name)]) for name in names),
        )

    def batch(self, rows: Tensor) -> tuple[dict[str, Tensor], Tensor]:
        """Returns the observations, images 0 to 1, and the views of some scenes."""
        observations = {key: value[rows] for key, value in self.observations.items()}
        observations["image"] = observations["image"].float() / 255.0
        return observations, self.views[rows]


def train_greedy_agent(
    bank: ViewBank,
    observation_space: spaces.Dict,
    hyperparameters: GreedyHyperparameters,
    seed: int,
    progress: bool = True,
    visibility_bank: ViewBank | None = None,
    device: torch.device = torch.device("cpu"),
) -> GreedyAgent:
    """Trains the networks of one agent; on the CPU the same arguments give the same weights.

    Uses one CPU thread: several sum in another order, and are not faster for such small networks.

    Args:
        bank: the training scenes.
        observation_space: images with channels first.
        hyperparameters: of networks and training.
        seed: of initial weights, order and augmentation.
        progress: show a progress bar.
        visibility_bank: further scenes with known visibilities only.
        device: where to train; holds all scenes.
    """
    datasets = []
    for mirrored in (False, True):
        dataset = ErrorDataset.from_bank(bank, mirrored, device)
        if visibility_bank is not None:
            more = ErrorDataset.from_bank(visibility_bank, mirrored, device)
            dataset = dataset.concatenate(more)
        datasets.append(dataset)
    rng = np.random.default_rng(np.random.SeedSequence([seed, 1]))
    forked = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices=forked), _one_thread():
        torch.manual_seed(int(rng.integers(2**31)))
        with torch.device("cpu"):  # initial weights are the same for every device
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
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def train_error_predictor(
    network: ErrorPredictor,
    datasets: Sequence[ErrorDataset],
    hyperparameters: GreedyHyperparameters,
    rng: np.random.Generator,
) -> Iterator[Tensor]:
    """Trains one network, each batch from a random dataset; yields each epoch's mean loss."""

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
    features, success = (tensor.to(device) for tensor in _labeled_estimates(bank))

    def batch_loss(rows: Tensor) -> Tensor:
        return F.binary_cross_entropy_with_logits(classifier(features[rows]), success[rows])

    hyperparameters = GreedyHyperparameters(epochs=10, batch_size=256)
    for _ in _fit(classifier, len(success), batch_loss, hyperparameters, rng):
        pass
    classifier.eval()


def _fit(
    network: nn.Module,
    count: int,
    batch_loss: Callable[[Tensor], Tensor],
    hyperparameters: GreedyHyperparameters,
    rng: np.random.Generator,
) -> Iterator[Tensor]:
    """Trains on batches of ``count`` rows; yields each epoch's mean loss."""
    h, device = hyperparameters, next(network.parameters()).device
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=h.learning_rate, weight_decay=h.weight_decay
    )
    batches = -(-count // h.batch_size)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, h.epochs * batches)
    network.train()
    for _ in range(h.epochs):
        total = torch.zeros((), device=device)  # a float would synchronize with the GPU
        for rows in np.array_split(rng.permutation(count), batches):
            loss = batch_loss(torch.from_numpy(rows).to(device))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            total += loss.detach() * len(rows)
        yield total / count


def _masked_loss(logits: Tensor, target: Tensor) -> Tensor:
    """Mean cross entropy over targets that are not NaN; 0 if there are none."""
    known = torch.isfinite(target)
    zeroed = torch.where(known, target, torch.zeros_like(target))
    losses = F.binary_cross_entropy_with_logits(logits, zeroed, reduction="none")
    return (losses * known).sum() / known.sum().clamp(min=1)


def augment(images: Tensor, rng: np.random.Generator) -> Tensor:
    """Shifts crops (B, 3, S, S) randomly and changes their brightness and contrast."""
    shift = rng.integers(-MAX_SHIFT, MAX_SHIFT + 1, 2).tolist()
    size = (len(images), 1, 1, 1)
    draws = rng.uniform(0.8, 1.2, size), rng.normal(0.0, 0.1, size)
    contrast, brightness = (
        torch.from_numpy(draw.astype(np.float32)).to(images.device) for draw in draws
    )
    return (torch.roll(images, shift, (2, 3)) * contrast + brightness).clamp(0.0, 1.0)


def _labeled_estimates(bank: ViewBank) -> tuple[Tensor, Tensor]:
    """Features of every estimate of a bank (M * (N + 1), F), and whether each is correct."""
    vectors = {key: array for key, array in bank.first.items() if key != "image"}
    first = {k: np.repeat(array[:, None], bank.slots, axis=1) for k, array in vectors.items()}
    second = dict(bank.second) | {"object": first["object"]}
    pairs = success_features(first, second).reshape(len(bank) * bank.slots, -1)
    single = success_features(bank.first, bank.first)
    features = torch.from_numpy(np.concatenate([pairs, single]))
    success = np.concatenate([bank.second_error.ravel(), bank.first_error]) < 0.1
    return features, torch.from_numpy(success.astype(np.float32))


def predicted_best_slots(agent: GreedyAgent, bank: ViewBank) -> np.ndarray:
    """The slot with the smallest predicted error in every scene of a bank, (M,)."""
    dataset = ErrorDataset.from_bank(bank, device=agent.device)
    observations, views = dataset.batch(torch.arange(len(bank), device=agent.device))
    return agent.predict(observations, views).argmin(axis=1)
