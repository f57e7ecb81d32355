"""Whether a pose is right, judged from what the robot knows: when to stop looking.

A bank holds the estimate after every second view and whether it was right. A small network learns
to tell from the keypoints' uncertainty, the detector's score, the object, the cameras and how far
the estimate moved since the first view. In ``TwoViewPoseSequential-v0`` an agent stops once its
judge is sure enough.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..envs.observation import Observation
from ..envs.view_bank import ViewBank

HIDDEN = 64

JUDGE_EPOCHS, JUDGE_BATCH, JUDGE_RATE = 10, 256, 1e-3


class Judge(nn.Module):
    """Logit of the probability that ADD(-S) is below a tenth of the diameter.

    Args:
        inputs: length of :func:`judge_features`.
        dropout: share of the hidden units that are left out in training.
    """

    def __init__(self, inputs: int, dropout: float = 0.2) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(inputs),
            nn.Linear(inputs, HIDDEN),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, 1),
        )

    def forward(self, features: Tensor) -> Tensor:
        """Logits (B,) from (B, inputs)."""
        return self.layers(features)[..., 0]


def judge_features(first: Mapping[str, np.ndarray], now: Mapping[str, np.ndarray]) -> np.ndarray:
    """What the judge is told, (..., F) float32.

    Args:
        first: observation after the reference view, or a batch of them.
        now: the newest observation of the same episodes.
    """
    moved = 10.0 * (now["translation"] - first["translation"])
    a, b = first["rotation"], now["rotation"]
    turned = np.stack(
        [(a[..., :3] * b[..., :3]).sum(-1), (a[..., 3:] * b[..., 3:]).sum(-1)], axis=-1
    )
    distance = np.linalg.norm(moved, axis=-1, keepdims=True)
    parts = (
        now["uncertainty"],
        first["uncertainty"],
        now["score"],
        first["score"],
        now["rotation"],
        now["translation"],
        now["camera"],
        first["camera"],
        now["object"],
        moved,
        np.log10(distance + 1e-3),
        turned,
    )
    return np.concatenate(parts, axis=-1).astype(np.float32)


def judged_pairs(bank: ViewBank) -> tuple[Tensor, Tensor]:
    """Features of every estimate of a bank (M * (N + 1), F), and whether each is right."""
    slots = bank.slots
    first: Observation = {
        key: np.repeat(array[:, None], slots, axis=1)
        for key, array in bank.first.items()
        if key != "image"
    }
    second = dict(bank.second) | {"object": first["object"]}
    pairs = judge_features(first, second).reshape(len(bank) * slots, -1)
    alone = judge_features(bank.first, bank.first)
    features = torch.from_numpy(np.concatenate([pairs, alone]))
    right = np.concatenate([(bank.second_error < 0.1).ravel(), bank.first_error < 0.1])
    return features, torch.from_numpy(right.astype(np.float32))


def judge_inputs(objects: int) -> int:
    """Length of :func:`judge_features` where the one-hot is of so many objects."""
    return 9 + 9 + 1 + 1 + 6 + 3 + 7 + 7 + objects + 3 + 1 + 2


def train_judge(judge: Judge, bank: ViewBank, rng: np.random.Generator) -> None:
    """Trains a judge on every estimate of a bank; ``rng`` draws the order."""
    device = next(judge.parameters()).device
    features, right = (tensor.to(device) for tensor in judged_pairs(bank))
    optimizer = torch.optim.AdamW(judge.parameters(), lr=JUDGE_RATE, weight_decay=1e-2)
    batches = -(-len(right) // JUDGE_BATCH)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, JUDGE_EPOCHS * batches)
    judge.train()
    for _ in range(JUDGE_EPOCHS):
        for rows in np.array_split(rng.permutation(len(right)), batches):
            chosen = torch.from_numpy(rows).to(device)
            loss = F.binary_cross_entropy_with_logits(judge(features[chosen]), right[chosen])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    judge.eval()
