"""What an agent's networks see of an observation: a small CNN beside the estimated state."""

from __future__ import annotations

from itertools import pairwise
from typing import cast

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn


class ViewExtractor(BaseFeaturesExtractor):
    """Features of one observation of ``TwoViewPose-v0`` and its kin.

    The crop goes through four convolutions that halve it each, the rest through one layer. Made for
    a thousand scenes, not for millions of frames: SB3's own NatureCNN has twenty times the weights
    and learns the training scenes by heart.

    Args:
        observation_space: a Dict with an ``image`` of channels first, as SB3 hands it over, and
            vectors.
        features_dim: how many features.
        width: channels of the first convolution.
        dropout: share of the crop's features that are left out in training.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        features_dim: int = 128,
        width: int = 12,
        dropout: float = 0.0,
    ) -> None:
        super().__init__(observation_space, features_dim)
        self._vectors, state = vector_fields(observation_space)
        channels = (3, width, 2 * width, 3 * width, 4 * width)
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise(channels):
            layers += [nn.Conv2d(inputs, outputs, 3, stride=2, padding=1), nn.ReLU()]
        self.cnn = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(4), nn.Flatten())
        self.image = nn.Sequential(nn.Linear(16 * channels[-1], 96), nn.ReLU(), nn.Dropout(dropout))
        self.state = nn.Sequential(nn.Linear(state, 64), nn.ReLU())
        self.join = nn.Sequential(nn.Linear(96 + 64, features_dim), nn.ReLU())

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Features (B, features_dim); the image is (B, 3, S, S), 0 to 1."""
        state = torch.cat([observations[key] for key in self._vectors], dim=1)
        image = self.image(self.cnn(observations["image"] - 0.5))
        return self.join(torch.cat([image, self.state(state)], dim=1))


def vector_fields(observation_space: spaces.Dict) -> tuple[tuple[str, ...], int]:
    """The fields of an observation but for the image, and how many numbers they are."""
    boxes = {key: cast(spaces.Box, part) for key, part in observation_space.spaces.items()}
    vectors = tuple(key for key in boxes if key != "image")
    return vectors, sum(int(boxes[key].shape[0]) for key in vectors)
