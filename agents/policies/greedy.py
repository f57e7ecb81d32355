"""``greedy``: a network predicts the error after every candidate view; take the best.

Frahm et al., "VIN-NBV: A View Introspection Network for Next-Best-View Selection" (2025), showed
for reconstruction that imitating the gain of each candidate and being greedy beats plain
reinforcement learning. A bank knows the outcome of every candidate of every scene, so here all of
them are targets at once; a reinforcement learner sees the reward of the one it took.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn

from ..networks.algorithms import GreedyHyperparameters
from ..networks.checkpoint import AgentHeader, check_tensors
from ..networks.predictor import ErrorPredictor, view_features
from ..networks.success_classifier import SuccessClassifier, success_features, success_inputs
from .baselines import Policy
from .view_sphere import (
    Action,
    camera_poses,
    check_view_sphere,
    travels,
    view_actions,
    view_directions,
)

MIN_SEPARATION = np.deg2rad(25.0)
"""Views closer than this to one that has been taken are left out, radians."""


def to_tensors(observation: Mapping[str, np.ndarray], device: torch.device) -> dict[str, Tensor]:
    """A batch of observations as the network takes them: images 0 to 1, channels first."""
    arrays = {key: np.ascontiguousarray(array) for key, array in observation.items()}
    tensors = {key: torch.from_numpy(array).to(device) for key, array in arrays.items()}
    tensors["image"] = tensors["image"].permute(0, 3, 1, 2).float() / 255.0
    return tensors


class GreedyAgent(nn.Module):
    """All that is trained: networks that predict errors, and a classifier of the newest pose.

    Args:
        observation_space: images with channels first.
        hyperparameters: its shape, and how many networks.
        crop_width_m: as in :class:`ErrorPredictor`; those of a file replace them.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        hyperparameters: GreedyHyperparameters,
        crop_width_m: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        objects = int(observation_space["object"].shape[0])  # type: ignore[index]
        h = hyperparameters
        widths = [1.0] * objects if crop_width_m is None else crop_width_m
        self.networks = nn.ModuleList(
            ErrorPredictor(observation_space, widths, h.features_dim, h.width, h.dropout)
            for _ in range(h.networks)
        )
        self.judge = SuccessClassifier(success_inputs(objects))

    @property
    def device(self) -> torch.device:
        """Where the networks are."""
        return next(self.parameters()).device

    @torch.inference_mode()
    def predict(self, observations: dict[str, Tensor], views: Tensor) -> np.ndarray:
        """Predicted min(ADD(-S) / diameter, 1) of N views, the mean over the networks, (B, N)."""
        logits = torch.stack([network(observations, views)[0] for network in self.networks])
        return torch.sigmoid(logits).mean(dim=0).cpu().numpy()

    @torch.inference_mode()
    def confidence(self, first: Mapping[str, np.ndarray], now: Mapping[str, np.ndarray]) -> float:
        """Probability that the pose of the newest of an episode's observations is right."""
        features = torch.from_numpy(success_features(first, now)).to(self.device)
        return float(torch.sigmoid(self.judge(features)))


def load_agent(
    header: AgentHeader,
    observation_space: spaces.Dict,
    weights: Mapping[str, Tensor],
    what: str,
    device: torch.device,
) -> GreedyAgent:
    """The networks of an agent file, on a device.

    Raises:
        InputError: if the weights do not fit the header.
    """
    with torch.random.fork_rng(devices=[]):  # their first random weights are not the caller's draws
        agent = GreedyAgent(observation_space, GreedyHyperparameters(**header.hyperparameters))
    check_tensors(weights, agent.state_dict(), what)
    agent.load_state_dict(weights)
    return agent.eval().to(device)


class GreedyPolicy(Policy):
    """Takes the view of least predicted error and travel cost.

    Where an episode may have several second views, it takes further ones until the probability of
    a right pose reaches the stop threshold, each time the best that is not near one it has taken.

    Args:
        agent: its networks.
        header: what its file says about it.
        env: the environment in which it acts: it asks it where its actions would send the camera.
    """

    def __init__(self, agent: GreedyAgent, header: AgentHeader, env: gym.Env) -> None:
        self._agent = agent
        self._env = check_view_sphere(env)
        self._keys = tuple(header.observation_space)
        self._threshold = GreedyHyperparameters(**header.hyperparameters).sure
        self._first: dict[str, np.ndarray] | None = None
        self._costs = np.zeros(0)

    def reset(self, rng: np.random.Generator) -> None:
        """Forgets the episode before; the policy draws nothing."""
        self._first = None

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """The best of the candidates; in a Box those of ``TwoViewPoseDiscrete-v0``."""
        known = {key: observation[key] for key in self._keys}
        stop = getattr(self._env, "stop_action", None)
        if stop is None or self._first is None:
            self._first, self._costs = known, self.predict(known)
        if stop is not None and self._agent.confidence(self._first, known) >= self._threshold:
            return int(stop)
        actions = view_actions(self._env)
        costs = self._costs + self._env.travel_weight * travels(self._env, actions)
        if stop is not None:
            costs = costs + self._near_taken(actions, observation["taken"])
        return actions[int(np.argmin(costs))]

    def predict(self, observation: Mapping[str, np.ndarray]) -> np.ndarray:
        """Predicted min(ADD(-S) / diameter, 1) of each of :func:`view_actions`, (N,)."""
        env: Any = self._env
        poses = camera_poses(env, view_actions(env))
        views = view_features(env.T_cam_world[None], env.sphere_center[None], poses[None])
        device = self._agent.device
        batch = to_tensors({key: observation[key][None] for key in self._keys}, device)
        return self._agent.predict(batch, torch.from_numpy(views).to(device))[0]

    def _near_taken(self, actions: list[Any], taken: np.ndarray) -> np.ndarray:
        """1 for candidates too near to one that has been taken, more for these themselves, (N,)."""
        directions = view_directions(self._env, actions)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        before = directions[taken > 0]
        if not len(before):
            return np.zeros(len(actions))
        near = (directions @ before.T).max(axis=1) > np.cos(MIN_SEPARATION)
        return near + 1.0 * (taken > 0)
