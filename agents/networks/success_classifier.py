"""A classifier of correct poses: when an agent of ``TwoViewPoseSequential-v0`` stops.

Its inputs are the keypoints' uncertainty, the detection confidence, the object, the cameras and the
change of the estimate since the first view.
"""

from collections.abc import Mapping

import numpy as np
from torch import Tensor, nn

HIDDEN = 64


class SuccessClassifier(nn.Module):
    """Logit of the probability that ADD(-S) is below a tenth of the diameter.

    Args:
        inputs: number of :func:`success_features`.
    """

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(inputs),
            nn.Linear(inputs, HIDDEN),
            nn.ReLU(),
            nn.Dropout(0.2),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, 1),
        )

    def forward(self, features: Tensor) -> Tensor:
        """Logits (B,) from (B, inputs)."""
        return self.layers(features)[..., 0]


def success_features(first: Mapping[str, np.ndarray], last: Mapping[str, np.ndarray]) -> np.ndarray:
    """Inputs of the classifier, (..., F) float32.

    Args:
        first: observation after the reference view, or a batch of them.
        last: the last observation of the same episodes.
    """
    shift = 10.0 * (last["translation"] - first["translation"])
    a, b = first["rotation"], last["rotation"]
    alignment = np.stack(
        [(a[..., :3] * b[..., :3]).sum(-1), (a[..., 3:] * b[..., 3:]).sum(-1)], axis=-1
    )
    distance = np.linalg.norm(shift, axis=-1, keepdims=True)
    parts = (
        last["uncertainty"],
        first["uncertainty"],
        last["score"],
        first["score"],
        last["rotation"],
        last["translation"],
        last["camera"],
        first["camera"],
        last["object"],
        shift,
        np.log10(distance + 1e-3),
        alignment,
    )
    return np.concatenate(parts, axis=-1).astype(np.float32)


def success_feature_count(objects: int) -> int:
    """Number of :func:`success_features` for a number of objects."""
    return 9 + 9 + 1 + 1 + 6 + 3 + 7 + 7 + objects + 3 + 1 + 2
