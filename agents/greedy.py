"""``greedy-predicted``: a network predicts the error after every candidate view; take the best.

Frahm et al., "VIN-NBV: A View Introspection Network for Next-Best-View Selection" (2025), showed
for reconstruction that imitating the gain of each candidate and being greedy beats plain
reinforcement learning. A bank knows the outcome of every candidate of every scene, so here all of
them teach at once, where a reinforcement learner is told of the one it took.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn

from ..envs.observation import SpherePosition
from .checkpoint import AgentHeader, check_tensors
from .extractor import ViewExtractor
from .view_sphere import Action, camera_poses, check_view_sphere, travels, view_actions

VIEW_FEATURES = 8


class ErrorPredictor(nn.Module):
    """Predicts min(ADD(-S) / diameter, 1) after a second view from each of N directions.

    Args:
        observation_space: of the environment, its image with channels first.
        features_dim, width, dropout: see :class:`ViewExtractor`.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        features_dim: int = 128,
        width: int = 12,
        dropout: float = 0.2,
    ) -> None:
        super().__init__()
        self.extractor = ViewExtractor(observation_space, features_dim, width, dropout)
        self.view = nn.Linear(VIEW_FEATURES, features_dim)
        self.mix = nn.Sequential(
            nn.Linear(features_dim, features_dim),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(features_dim, features_dim),
            nn.ReLU(),
        )
        self.head = nn.Linear(features_dim, 1)

    def forward(self, observations: dict[str, Tensor], views: Tensor) -> Tensor:
        """Logits (B, N) of the predicted errors.

        Args:
            observations: a batch, images 0 to 1 with channels first.
            views: (B, N, 8), see :func:`view_features`.
        """
        scene = self.extractor(observations)
        return self.head(self.mix(scene[:, None] + self.view(views)))[..., 0]


def view_features(azimuth: np.ndarray, elevation: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """What the network is told of a candidate view.

    Args:
        azimuth: (..., N) from the reference camera's, radians.
        elevation: (..., N) radians.
        reference: (...) elevation of the reference camera, radians.

    Returns:
        (..., N, 8) float32: direction from the object, angle to the reference view and elevation.
    """
    reference = np.broadcast_to(reference[..., None], azimuth.shape)
    flat, flat_reference = np.cos(elevation), np.cos(reference)
    cosine = flat * flat_reference * np.cos(azimuth) + np.sin(elevation) * np.sin(reference)
    angle = np.arccos(np.clip(cosine, -1, 1))
    parts = (
        flat * np.cos(azimuth),
        flat * np.sin(azimuth),
        np.sin(elevation),
        angle,
        np.sin(angle),
        np.sin(2 * azimuth),
        np.cos(2 * azimuth),
        elevation - reference,
    )
    return np.stack(parts, axis=-1).astype(np.float32)


def to_tensors(observation: Mapping[str, np.ndarray]) -> dict[str, Tensor]:
    """A batch of observations as the network takes them: images 0 to 1, channels first."""
    tensors = {k: torch.from_numpy(np.ascontiguousarray(a)) for k, a in observation.items()}
    tensors["image"] = tensors["image"].permute(0, 3, 1, 2).float() / 255.0
    return tensors


def predicted_errors(
    networks: nn.ModuleList, observations: dict[str, Tensor], views: Tensor
) -> Tensor:
    """The mean over several networks of what they predict, 0 to 1, (B, N)."""
    return torch.stack([torch.sigmoid(net(observations, views)) for net in networks]).mean(0)


def make_networks(
    observation_space: spaces.Dict, hyperparameters: Mapping[str, Any]
) -> nn.ModuleList:
    """Untrained networks, images with channels first."""
    names = ("features_dim", "width", "dropout")
    shape = {name: hyperparameters[name] for name in names if name in hyperparameters}
    count = int(hyperparameters.get("networks", 1))
    return nn.ModuleList(ErrorPredictor(observation_space, **shape) for _ in range(count))


def load_networks(
    header: AgentHeader, observation_space: spaces.Dict, weights: Mapping[str, Tensor], what: str
) -> nn.ModuleList:
    """The networks of an agent file.

    Raises:
        ValueError: if the weights do not fit the header.
    """
    with torch.random.fork_rng(devices=[]):  # their first random weights are not the caller's draws
        networks = make_networks(observation_space, header.hyperparameters)
    check_tensors(weights, networks.state_dict(), what)
    networks.load_state_dict(weights)
    return networks


class GreedyPolicy:
    """Takes the view of least predicted error and travel cost.

    Args:
        networks: predict errors; their mean counts.
        header: what its file says about it.
        env: the environment in which it acts: it asks it where its actions would send the camera.
        name: what tables call it.
    """

    def __init__(
        self, networks: nn.ModuleList, header: AgentHeader, env: gym.Env, name: str
    ) -> None:
        self.name, self.header = name, header
        self._networks = networks.eval()
        self._env = check_view_sphere(env)

    def reset(self, rng: np.random.Generator) -> None:
        """Nothing to do: the policy draws nothing and remembers nothing."""

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """The best of the candidates; in a Box those of ``TwoViewPoseDiscrete-v0``."""
        actions = view_actions(self._env)
        costs = self.predict(observation) + self._env.travel_weight * travels(self._env, actions)
        return actions[int(np.argmin(costs))]

    @torch.inference_mode()
    def predict(self, observation: Mapping[str, np.ndarray]) -> np.ndarray:
        """Predicted min(ADD(-S) / diameter, 1) of each of :func:`view_actions`, (N,)."""
        env: Any = self._env
        reference = env.reference_position
        poses = camera_poses(env, view_actions(env))
        seen = [SpherePosition.of(T, env.sphere_centre) for T in poses]
        views = view_features(
            np.array([[p.azimuth - reference.azimuth for p in seen]]),
            np.array([[p.elevation for p in seen]]),
            np.array([reference.elevation]),
        )
        batch = to_tensors({key: value[None] for key, value in observation.items()})
        return predicted_errors(self._networks, batch, torch.from_numpy(views))[0].numpy()
