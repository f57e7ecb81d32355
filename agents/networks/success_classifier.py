"""Whether a pose is right, classified from what the robot knows: when to stop looking.

A small network predicts it from the keypoints' uncertainty, the detector's score, the object, the
cameras and how far the estimate moved since the first view. In ``TwoViewPoseSequential-v0`` an
agent stops once the probability reaches its stop threshold.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from torch import Tensor, nn

HIDDEN = 64


class SuccessClassifier(nn.Module):
    """Logit of the probability that ADD(-S) is below a tenth of the diameter.

    Args:
        inputs: length of :func:`success_features`.
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


def success_features(first: Mapping[str, np.ndarray], now: Mapping[str, np.ndarray]) -> np.ndarray:
    """Inputs of the classifier, (..., F) float32.

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


def success_inputs(objects: int) -> int:
    """Length of :func:`success_features` where the one-hot is of so many objects."""
    return 9 + 9 + 1 + 1 + 6 + 3 + 7 + 7 + objects + 3 + 1 + 2
