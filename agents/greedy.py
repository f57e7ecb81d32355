"""``greedy-predicted``: a network predicts the error after every candidate view; take the best.

Frahm et al., "VIN-NBV: A View Introspection Network for Next-Best-View Selection" (2025), showed
for reconstruction that imitating the gain of each candidate and being greedy beats plain
reinforcement learning. A bank knows the outcome of every candidate of every scene, so here all of
them teach at once, where a reinforcement learner is told of the one it took.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn
from torch.nn import functional as F

from ..envs.observation import SURROUNDINGS
from ..pose_estimator.features import FeatureConfig
from .checkpoint import AgentHeader, check_tensors
from .extractor import ViewExtractor
from .judge import Judge, judge_features, judge_inputs
from .view_sphere import (
    Action,
    camera_poses,
    check_view_sphere,
    travels,
    view_actions,
    view_directions,
)

VIEW_FEATURES = 8

ROI_SCALE = FeatureConfig().roi_scale
"""Side of a region of interest in object diameters."""

SURE = 0.85
"""Probability of a right pose from which on an agent does not look again."""

NEAR = np.deg2rad(25.0)
"""Views so close to one that has been taken are left out."""

LINE_POINTS = (0.0, 0.04, 0.08, 0.12, 0.17, 0.23, 0.3)
"""Distances from the object in metres at which the line of sight is looked up in the crop."""


class ErrorPredictor(nn.Module):
    """Predicts min(ADD(-S) / diameter, 1) after a second view from each of N directions.

    What would hide the object from a view stands on the line from the object to that camera, and
    that line is seen in the reference picture. So besides the whole crop, the network looks at the
    crop's features along the projected line of every candidate: what it learns of a box to the
    left serves for one to the right. It also predicts how much of the object a view would show,
    which teaches it to see what is in the way.

    Args:
        observation_space: of the environment, its image with channels first.
        spans: for each object how many metres the crop is wide at the object, (n,).
        features_dim, width, dropout: see :class:`ViewExtractor`.
    """

    spans: Tensor

    def __init__(
        self,
        observation_space: spaces.Dict,
        spans: Sequence[float],
        features_dim: int = 128,
        width: int = 12,
        dropout: float = 0.2,
    ) -> None:
        super().__init__()
        self.extractor = ViewExtractor(observation_space, features_dim, width, dropout)
        self.register_buffer("spans", torch.tensor(spans, dtype=torch.float32))
        self.lines = nn.Sequential(
            nn.Conv2d(3, width, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(width, 2 * width, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(2 * width, width, 3, padding=1),
            nn.ReLU(),
        )
        self.line = nn.Sequential(nn.Dropout(dropout), nn.Linear(len(LINE_POINTS) * width, 64))
        self.view = nn.Linear(VIEW_FEATURES + 64, features_dim)
        self.mix = nn.Sequential(
            nn.ReLU(),
            nn.Linear(features_dim, features_dim),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(features_dim, features_dim),
            nn.ReLU(),
        )
        self.visibility = nn.Linear(features_dim, 1)
        self.error = nn.Linear(features_dim + 1, 1)

    def forward(self, observations: dict[str, Tensor], views: Tensor) -> tuple[Tensor, Tensor]:
        """Logits of the predicted errors and of the visible fractions of the object, (B, N) each.

        Args:
            observations: a batch, images 0 to 1 with channels first.
            views: (B, N, 11), see :func:`view_features`.
        """
        scene = self.extractor(observations)
        maps = self.lines(observations["image"] - 0.5)
        seen = F.grid_sample(maps, self.line_of_sight(observations, views), align_corners=False)
        line = F.relu(self.line(seen.permute(0, 2, 3, 1).flatten(2)))
        told = torch.cat([views[..., :VIEW_FEATURES], line], dim=-1)
        mixed = self.mix(scene[:, None] + self.view(told))
        visible = self.visibility(mixed)
        error = self.error(torch.cat([mixed, torch.sigmoid(visible)], dim=-1))
        return error[..., 0], visible[..., 0]

    def line_of_sight(self, observations: dict[str, Tensor], views: Tensor) -> Tensor:
        """Where the lines from the object to the candidates are in the crop.

        Returns:
            (B, N, P, 2) places of P points, -1 to 1 within the crop.
        """
        right, down, forward = views[..., VIEW_FEATURES:].unbind(-1)
        along = torch.tensor(LINE_POINTS)
        half = (observations["object"] @ self.spans).clamp(min=1e-3)[:, None, None] / 2
        distance = observations["camera"][:, 0].clamp(min=0.2)[:, None, None]
        nearer = distance / (distance + forward[..., None] * along).clamp(min=0.1)
        places = torch.stack([right[..., None] * along, down[..., None] * along], dim=-1)
        return places * (nearer / half)[..., None]


def crop_spans(diameters: Sequence[float]) -> list[float]:
    """How many metres a crop is wide at an object that its region of interest fits, for each."""
    return [SURROUNDINGS * ROI_SCALE * diameter for diameter in diameters]


def view_features(
    T_cam_world: np.ndarray, centre: np.ndarray, T_second_world: np.ndarray, mirrored: bool = False
) -> np.ndarray:
    """What the network is told of candidate views.

    Args:
        T_cam_world: reference camera, (..., 4, 4).
        centre: the object, (..., 3), world.
        T_second_world: cameras of the candidates, (..., N, 4, 4).
        mirrored: tell it of the same scene in a mirror.

    Returns:
        (..., N, 11) float32: direction from the object with the reference camera at azimuth 0,
        angle to the reference view, elevations; then the direction in the reference camera: right,
        down, forward.
    """

    def directions(T: np.ndarray, middle: np.ndarray) -> np.ndarray:
        offset = -np.einsum("...ji,...j->...i", T[..., :3, :3], T[..., :3, 3]) - middle
        return offset / np.linalg.norm(offset, axis=-1, keepdims=True)

    first = directions(T_cam_world, centre)[..., None, :]
    second = directions(T_second_world, centre[..., None, :])
    seen = np.einsum("...ij,...nj->...ni", T_cam_world[..., :3, :3], second)
    azimuth = np.arctan2(second[..., 1], second[..., 0]) - np.arctan2(first[..., 1], first[..., 0])
    azimuth = -azimuth if mirrored else azimuth
    elevation, reference = np.arcsin(second[..., 2]), np.arcsin(first[..., 2])
    angle = np.arccos(np.clip((first * second).sum(axis=-1), -1, 1))
    parts = (
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation),
        angle,
        np.sin(angle),
        np.sin(2 * azimuth),
        np.cos(2 * azimuth),
        elevation - reference,
        -seen[..., 0] if mirrored else seen[..., 0],
        seen[..., 1],
        seen[..., 2],
    )
    return np.stack(parts, axis=-1).astype(np.float32)


def to_tensors(observation: Mapping[str, np.ndarray]) -> dict[str, Tensor]:
    """A batch of observations as the network takes them: images 0 to 1, channels first."""
    tensors = {k: torch.from_numpy(np.ascontiguousarray(a)) for k, a in observation.items()}
    tensors["image"] = tensors["image"].permute(0, 3, 1, 2).float() / 255.0
    return tensors


class GreedyAgent(nn.Module):
    """All that is trained: networks that predict errors, and a judge of the newest pose.

    Args:
        observation_space: images with channels first.
        hyperparameters: see `GreedyHyperparameters`, as plain data.
        spans: as in :class:`ErrorPredictor`; those of a file replace them.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        hyperparameters: Mapping[str, Any],
        spans: Sequence[float] | None = None,
    ) -> None:
        super().__init__()
        objects = int(observation_space["object"].shape[0])  # type: ignore[index]
        names = ("features_dim", "width", "dropout")
        shape = {name: hyperparameters[name] for name in names if name in hyperparameters}
        widths = [1.0] * objects if spans is None else spans
        self.networks = nn.ModuleList(
            ErrorPredictor(observation_space, widths, **shape)
            for _ in range(int(hyperparameters.get("networks", 1)))
        )
        self.judge = Judge(judge_inputs(objects))

    @torch.inference_mode()
    def predict(self, observations: dict[str, Tensor], views: Tensor) -> np.ndarray:
        """Predicted min(ADD(-S) / diameter, 1) of N views, the mean over the networks, (B, N)."""
        logits = torch.stack([network(observations, views)[0] for network in self.networks])
        return torch.sigmoid(logits).mean(dim=0).numpy()

    @torch.inference_mode()
    def sureness(self, first: Mapping[str, np.ndarray], now: Mapping[str, np.ndarray]) -> float:
        """Probability that the pose of the newest of an episode's observations is right."""
        return float(torch.sigmoid(self.judge(torch.from_numpy(judge_features(first, now)))))


def load_agent(
    header: AgentHeader, observation_space: spaces.Dict, weights: Mapping[str, Tensor], what: str
) -> GreedyAgent:
    """The networks of an agent file.

    Raises:
        ValueError: if the weights do not fit the header.
    """
    with torch.random.fork_rng(devices=[]):  # their first random weights are not the caller's draws
        agent = GreedyAgent(observation_space, header.hyperparameters)
    check_tensors(weights, agent.state_dict(), what)
    agent.load_state_dict(weights)
    return agent.eval()


class GreedyPolicy:
    """Takes the view of least predicted error and travel cost.

    Where an episode may have several second views, it goes on until its judge is sure of the pose,
    each time to the best view that is not near one it has taken.

    Args:
        agent: its networks.
        header: what its file says about it.
        env: the environment in which it acts: it asks it where its actions would send the camera.
        name: what tables call it.
    """

    def __init__(self, agent: GreedyAgent, header: AgentHeader, env: gym.Env, name: str) -> None:
        self.name, self.header = name, header
        self._agent = agent
        self._env = check_view_sphere(env)
        self._keys = tuple(header.observation_space)
        self._sure = float(header.hyperparameters.get("sure", SURE))
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
        if stop is not None and self._agent.sureness(self._first, known) >= self._sure:
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
        views = view_features(env.T_cam_world[None], env.sphere_centre[None], poses[None])
        batch = to_tensors({key: observation[key][None] for key in self._keys})
        return self._agent.predict(batch, torch.from_numpy(views))[0]

    def _near_taken(self, actions: list[Any], taken: np.ndarray) -> np.ndarray:
        """1 for candidates too near to one that has been taken, more for these themselves, (N,)."""
        directions = view_directions(self._env, actions)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        before = directions[taken > 0]
        if not len(before):
            return np.zeros(len(actions))
        near = (directions @ before.T).max(axis=1) > np.cos(NEAR)
        return near + 1.0 * (taken > 0)
