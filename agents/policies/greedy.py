"""``greedy``: networks predict the error after every candidate view; the policy takes the best.

Frahm et al., "VIN-NBV: A View Introspection Network for Next-Best-View Selection" (2025), showed
for reconstruction that regressing the gain of each candidate and being greedy beats plain
reinforcement learning. A bank holds the outcome of every candidate of every scene, so all of them
are targets at once; a reinforcement learner sees the reward of the one it took.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn

from ...core.errors import InputError
from ..networks.algorithms import GreedyHyperparameters
from ..networks.checkpoint import AgentHeader, check_tensors
from ..networks.predictor import ErrorPredictor, view_features
from ..networks.success_classifier import SuccessClassifier, success_feature_count, success_features
from .baselines import Policy
from .view_sphere import (
    Action,
    camera_poses,
    candidate_actions,
    check_view_sphere,
    travel_distances,
    view_directions,
)

MIN_SEPARATION = np.deg2rad(25.0)
"""Minimum angle between a view and those already taken, radians."""


def to_tensors(observation: Mapping[str, np.ndarray], device: torch.device) -> dict[str, Tensor]:
    """Converts a batch of observations to the network's inputs: images 0 to 1, channels first."""
    arrays = {key: np.ascontiguousarray(array) for key, array in observation.items()}
    tensors = {key: torch.from_numpy(array).to(device) for key, array in arrays.items()}
    tensors["image"] = tensors["image"].permute(0, 3, 1, 2).float() / 255.0
    return tensors


class GreedyAgent(nn.Module):
    """An ensemble of error predictors, and a success classifier (``judge`` in agent files).

    Args:
        observation_space: images with channels first.
        hyperparameters: size and number of the networks.
        crop_width_m: see :class:`ErrorPredictor`; a file's values replace them.
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
        self.judge = SuccessClassifier(success_feature_count(objects))

    @property
    def device(self) -> torch.device:
        """Device of the networks."""
        return next(self.parameters()).device

    @torch.inference_mode()
    def predict(self, observations: dict[str, Tensor], views: Tensor) -> np.ndarray:
        """Ensemble mean of the predicted min(ADD(-S) / diameter, 1) of N views, (B, N)."""
        logits = torch.stack([network(observations, views)[0] for network in self.networks])
        return torch.sigmoid(logits).mean(dim=0).cpu().numpy()

    @torch.inference_mode()
    def confidence(self, first: Mapping[str, np.ndarray], last: Mapping[str, np.ndarray]) -> float:
        """Probability that the pose of an episode's last observation is correct."""
        features = torch.from_numpy(success_features(first, last)).to(self.device)
        return float(torch.sigmoid(self.judge(features)))


def load_agent(
    header: AgentHeader,
    observation_space: spaces.Dict,
    weights: Mapping[str, Tensor],
    source: str,
    device: torch.device,
) -> GreedyAgent:
    """Builds the networks; raises InputError, naming ``source``, if weights and header differ."""
    hyperparameters = GreedyHyperparameters(**header.hyperparameters)
    if "object" not in observation_space.spaces or "image" not in observation_space.spaces:
        raise InputError(f"{source} must observe object and image, got {observation_space}")
    with torch.device("meta"):  # a damaged header must not fill the memory
        shapes = GreedyAgent(observation_space, hyperparameters).state_dict()
    check_tensors(weights, shapes, source)
    with torch.random.fork_rng(devices=[]):  # random initial weights leave the caller's RNG as is
        agent = GreedyAgent(observation_space, hyperparameters)
    agent.load_state_dict(weights)
    return agent.eval().to(device)


class GreedyPolicy(Policy):
    """Takes the view with the smallest sum of predicted error and travel cost.

    In episodes of several second views, it takes further ones until the probability of a correct
    pose reaches the stop threshold, each time the best that is not near one already taken.

    Args:
        agent: its networks.
        header: header of its file.
        env: the environment in which it acts, queried for the cameras after its actions.
    """

    def __init__(self, agent: GreedyAgent, header: AgentHeader, env: gym.Env) -> None:
        self.agent = agent
        self._env = check_view_sphere(env)
        self._keys = tuple(header.observation_space)
        self._threshold = GreedyHyperparameters(**header.hyperparameters).sure
        self._first: dict[str, np.ndarray] | None = None
        self._costs = np.zeros(0)

    def reset(self, rng: np.random.Generator) -> None:
        """Starts an episode; the policy is deterministic."""
        self._first = None

    def act(self, observation: Mapping[str, np.ndarray]) -> Action:
        """Returns the best candidate; in a Box those of ``TwoViewPoseDiscrete-v0``."""
        known = {key: observation[key] for key in self._keys}
        stop = getattr(self._env, "stop_action", None)
        if stop is None or self._first is None:
            self._first, self._costs = known, self.predict(known)
        if stop is not None and self.agent.confidence(self._first, known) >= self._threshold:
            return int(stop)
        actions = candidate_actions(self._env)
        costs = self._costs + self._env.travel_weight * travel_distances(self._env, actions)
        if stop is not None:
            costs = costs + self._taken_penalty(actions, observation["taken"])
        return actions[int(np.argmin(costs))]

    def predict(self, observation: Mapping[str, np.ndarray]) -> np.ndarray:
        """Predicted min(ADD(-S) / diameter, 1) of each of :func:`candidate_actions`, (N,)."""
        env: Any = self._env
        poses = camera_poses(env, candidate_actions(env))
        views = view_features(env.T_cam_world[None], env.sphere_center[None], poses[None])
        device = self.agent.device
        batch = to_tensors({key: observation[key][None] for key in self._keys}, device)
        return self.agent.predict(batch, torch.from_numpy(views).to(device))[0]

    def _taken_penalty(self, actions: list[Any], taken: np.ndarray) -> np.ndarray:
        """1 for candidates too near to one already taken, 2 for the taken ones, (N,)."""
        directions = view_directions(self._env, actions)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        before = directions[taken > 0]
        if not len(before):
            return np.zeros(len(actions))
        near = (directions @ before.T).max(axis=1) > np.cos(MIN_SEPARATION)
        return near + 1.0 * (taken > 0)
