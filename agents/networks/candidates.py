"""A feature extractor for SB3 that is pretrained to predict occlusion.

It holds one of the networks of ``--algo greedy``, and its features are the error and visibility
predicted for each of the 24 candidate views. The candidates' directions are computed from the
observation alone, so a trained policy needs no other input.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from ...core.errors import InputError
from ...envs.two_view_pose import CANDIDATE_VIEWS
from .checkpoint import check_tensors, read_agent, subset
from .predictor import ErrorPredictor, vector_fields


class CandidateExtractor(BaseFeaturesExtractor):
    """Predicted errors and visibilities of the candidates, and the estimated state.

    Args:
        observation_space: a Dict with an ``image`` of channels first.
        features_dim: width of the predictor, see :class:`ErrorPredictor`.
        width, dropout: of the predictor.
        frozen: do not train the predictor.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        features_dim: int = 128,
        width: int = 12,
        dropout: float = 0.0,
        frozen: bool = True,
    ) -> None:
        self._vectors, state = vector_fields(observation_space)
        super().__init__(observation_space, 2 * len(CANDIDATE_VIEWS) + state)
        objects = int(observation_space["object"].shape[0])  # type: ignore[index]
        self.predictor = ErrorPredictor(
            observation_space, [1.0] * objects, features_dim, width, dropout
        )
        self._frozen = frozen
        if frozen:
            self.predictor.requires_grad_(False)

    def train(self, mode: bool = True) -> CandidateExtractor:
        """Keeps a frozen predictor in evaluation mode."""
        super().train(mode)
        if self._frozen:
            self.predictor.eval()
        return self

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Features (B, 48 + state); the image is (B, 3, S, S), 0 to 1."""
        views = candidate_features(observations["camera"], observations["translation"])
        error, visible = self.predictor(observations, views)
        state = [observations[key] for key in self._vectors]
        return torch.cat([error, visible, *state], dim=1)


def load_pretrained_extractor(policy: nn.Module, path: Path) -> None:
    """Loads the first network of a greedy agent into all extractors of a policy.

    Raises InputError if the policy has no such extractor, or the file is not a greedy agent.
    """
    _, tensors = read_agent(path, prefix="policy/networks.0.")
    weights = subset(tensors, "policy/networks.0.")
    extractors = [m for m in policy.modules() if isinstance(m, CandidateExtractor)]
    if not extractors or not weights:
        raise InputError(
            f"pretrained_extractor needs an agent of --algo greedy, got {path}, and "
            "hyper-parameters with features_extractor_class: CandidateExtractor"
        )
    for extractor in extractors:
        check_tensors(weights, extractor.predictor.state_dict(), f"agent file {path}")
        extractor.predictor.load_state_dict(weights)


def candidate_features(camera: Tensor, translation: Tensor) -> Tensor:
    """Computes ``view_features`` of the 24 candidates (B, 24, 11) from the first observation.

    Args:
        camera: the observation's, (B, 7).
        translation: of the object in the reference camera, (B, 3) meters.
    """
    sin_e, roll = camera[:, 1], torch.atan2(camera[:, 5], camera[:, 6])
    elevation = torch.atan2(camera[:, 1], camera[:, 2])
    back = -nn.functional.normalize(translation, dim=1)  # from the object to the camera
    # Up in the camera's frame is (-s sin roll, -s cos roll, c); its part along `back` is sin_e.
    p = -(back[:, 0] * torch.sin(roll) + back[:, 1] * torch.cos(roll))
    g = back[:, 2]
    phase = torch.atan2(g, p)
    apart = torch.arccos((sin_e / torch.hypot(p, g).clamp(min=1e-6)).clamp(-1, 1))
    a, b = phase + apart, phase - apart
    tilt = torch.where(_angle_diff(a, -elevation) < _angle_diff(b, -elevation), a, b)
    s, c = torch.cos(tilt), torch.sin(tilt)
    up = torch.stack([-s * torch.sin(roll), -s * torch.cos(roll), c], dim=1)
    ahead = nn.functional.normalize(back - (back * up).sum(1, keepdim=True) * up, dim=1)
    side = torch.linalg.cross(up, ahead)
    azimuths, elevations = torch.tensor(
        np.deg2rad(CANDIDATE_VIEWS), dtype=camera.dtype, device=camera.device
    ).unbind(1)
    level, z = torch.cos(elevations), torch.sin(elevations)
    x, y = level * torch.cos(azimuths), level * torch.sin(azimuths)
    in_camera = x[:, None] * ahead[:, None] + y[:, None] * side[:, None] + z[:, None] * up[:, None]
    cosine = torch.cos(elevation)[:, None] * x + torch.sin(elevation)[:, None] * z
    angle = torch.arccos(cosine.clamp(-1, 1))
    parts = [
        *(x, y, z, angle, torch.sin(angle), torch.sin(2 * azimuths), torch.cos(2 * azimuths)),
        elevations - elevation[:, None],
        *in_camera.unbind(-1),
    ]
    return torch.stack([part.expand_as(angle) for part in parts], dim=-1)


def _angle_diff(a: Tensor, b: Tensor) -> Tensor:
    """Absolute difference of two angles, radians."""
    return torch.abs(torch.remainder(a - b + torch.pi, 2 * torch.pi) - torch.pi)
