"""The network that predicts the pose error after a second view, from the first one.

An occluder of a view stands on the line of sight from the object to that camera, and that line is
visible in the reference image: the network samples its features along it.
"""

from collections.abc import Sequence
from typing import cast

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor, nn
from torch.nn import functional as F

from ...envs.observation import CROP_SCALE
from ...envs.simulation.carrier import directions_from
from ...pose_estimator.networks.features import FeatureConfig

VIEW_FEATURES = 8

LINE_POINTS = (0.0, 0.03, 0.06, 0.09, 0.12, 0.16, 0.2, 0.25, 0.3)
"""Distances from the object in meters at which the line of sight is sampled in the crop."""


class ErrorPredictor(nn.Module):
    """Predicts min(ADD(-S) / diameter, 1) after a second view from each of N directions.

    In addition to the whole crop, the network samples the crop's features along the projected line
    of sight of every candidate, so occluders on all sides share weights. Predicting the visibility
    from a view is an auxiliary task.

    Args:
        observation_space: of the environment, its image with channels first.
        crop_width_m: for each object the width of the crop at the object in meters, (n,).
        features_dim: width of the layers that join the features of scene and view.
        width: channels of the first convolution.
        dropout: dropout probability.
    """

    spans: Tensor
    """``crop_width_m``, under its name in agent files."""

    def __init__(
        self,
        observation_space: spaces.Dict,
        crop_width_m: Sequence[float],
        features_dim: int = 128,
        width: int = 12,
        dropout: float = 0.2,
    ) -> None:
        super().__init__()
        self._vectors, state = vector_fields(observation_space)
        self.register_buffer("spans", torch.tensor(crop_width_m, dtype=torch.float32))
        self.lines = nn.Sequential(
            nn.Conv2d(3, width, 5, stride=2, padding=2),
            nn.ReLU(),
            nn.Conv2d(width, 2 * width, 3, stride=2, padding=1),
            nn.BatchNorm2d(2 * width),
            nn.ReLU(),
            nn.Conv2d(2 * width, 2 * width, 3, padding=1),
            nn.BatchNorm2d(2 * width),
            nn.ReLU(),
            nn.Conv2d(2 * width, 2 * width, 3, padding=2, dilation=2),
            nn.BatchNorm2d(2 * width),
            nn.ReLU(),
        )
        self.whole = nn.Sequential(
            nn.Conv2d(2 * width, 3 * width, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(3 * width, 4 * width, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.AdaptiveAvgPool2d(4),
            nn.Flatten(),
            nn.Dropout(dropout),
            nn.Linear(16 * 4 * width, 96),
            nn.ReLU(),
        )
        self.state = nn.Sequential(nn.Linear(state, 64), nn.ReLU())
        self.scene = nn.Linear(96 + 64, features_dim)
        self.line = nn.Sequential(nn.Dropout(dropout), nn.Linear(2 * len(LINE_POINTS) * width, 64))
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
        maps = self.lines(observations["image"] - 0.5)
        state = self.state(torch.cat([observations[key] for key in self._vectors], dim=1))
        scene = self.scene(torch.cat([self.whole(maps), state], dim=1))
        samples = F.grid_sample(maps, self.line_of_sight(observations, views), align_corners=False)
        line = F.relu(self.line(samples.permute(0, 2, 3, 1).flatten(2)))
        view = self.view(torch.cat([views[..., :VIEW_FEATURES], line], dim=-1))
        mixed = self.mix(scene[:, None] + view)
        visible = self.visibility(mixed)
        error = self.error(torch.cat([mixed, torch.sigmoid(visible)], dim=-1))
        return error[..., 0], visible[..., 0]

    def line_of_sight(self, observations: dict[str, Tensor], views: Tensor) -> Tensor:
        """Projects P points of the lines from the object to the candidates into the crop.

        Returns:
            (B, N, P, 2) grid coordinates, -1 to 1 within the crop.
        """
        right, down, forward = views[..., VIEW_FEATURES:].unbind(-1)
        along = torch.tensor(LINE_POINTS, device=views.device)
        half = (observations["object"] @ self.spans).clamp(min=1e-3)[:, None, None] / 2
        distance = observations["camera"][:, 0].clamp(min=0.2)[:, None, None]
        scale = distance / (distance + forward[..., None] * along).clamp(min=0.1)
        offsets = torch.stack([right[..., None] * along, down[..., None] * along], dim=-1)
        return offsets * (scale / half)[..., None]


def vector_fields(observation_space: spaces.Dict) -> tuple[tuple[str, ...], int]:
    """Names of an observation's fields other than the image, and their total size."""
    boxes = {key: cast(spaces.Box, part) for key, part in observation_space.spaces.items()}
    vectors = tuple(key for key in boxes if key != "image")
    return vectors, sum(int(boxes[key].shape[0]) for key in vectors)


def crop_widths(diameters: Sequence[float]) -> list[float]:
    """Widths in meters, at the object, of the crops of objects of these diameters."""
    return [CROP_SCALE * FeatureConfig().roi_scale * diameter for diameter in diameters]


def view_features(
    T_cam_world: np.ndarray, center: np.ndarray, T_second_world: np.ndarray, mirrored: bool = False
) -> np.ndarray:
    """Computes the network's inputs for candidate views.

    Args:
        T_cam_world: reference camera, (..., 4, 4).
        center: the object, (..., 3), world.
        T_second_world: cameras of the candidates, (..., N, 4, 4).
        mirrored: mirror the scene left to right.

    Returns:
        (..., N, 11) float32: direction from the object with the reference camera at azimuth 0,
        angle to the reference view, elevations; then the direction in the reference camera: right,
        down, forward.
    """
    first = directions_from(center, T_cam_world)[..., None, :]
    second = directions_from(center[..., None, :], T_second_world)
    in_camera = np.einsum("...ij,...nj->...ni", T_cam_world[..., :3, :3], second)
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
        -in_camera[..., 0] if mirrored else in_camera[..., 0],
        in_camera[..., 1],
        in_camera[..., 2],
    )
    return np.stack(parts, axis=-1).astype(np.float32)
