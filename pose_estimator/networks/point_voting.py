"""Keypoints by voting of a depth sensor's points: the RGB-D baseline of the study.

After REDE (Hua et al., "REDE: End-to-end object 6D pose robust estimation using differentiable
outliers elimination", RA-L 2021), DenseFusion (Wang et al., CVPR 2019) and PVN3D (He et al., CVPR
2020): each point takes the 2D features of its pixel, a PointNet adds global features of the cloud,
and each point predicts offsets to the keypoints and a confidence. Predictions are corrections of
the 2D votes, as in Mid-Fusion's volume. Keypoints are confidence-weighted means of the points'
votes; outliers are down-weighted softly, which is differentiable.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .decoder import ConvBlock
from .features import KEYPOINTS
from .point_cloud import PointCloud

_MIN_LOG_ERROR = math.log(0.01)
_MAX_LOG_ERROR = math.log(1.0)
"""Limits of the logarithm of a vote's expected error, in diameters."""

_OUTLIER_SCALE = 0.1
"""Distance in diameters from the mean at which a vote loses three quarters of its weight."""

_ITERATIONS = 2
"""Iterations of reweighting."""

_MAX_DISPLACEMENT = 2.0
"""Diameters to which the displacements of the 2D votes are clipped."""

_OUTPUTS = 5
"""Outputs of a point for a keypoint: offset (3), log error, logit of the 2D vote's weight."""

_INITIAL_VOTE_LOGIT = 2.0
"""Initial logit of the 2D votes' weight."""


@dataclass(frozen=True)
class PointConfig:
    """Shape of the point network.

    Attributes:
        points: samples of a crop.
        width: channels of a point.
        pooled: channels of the cloud.
    """

    points: int = 256
    width: int = 128
    pooled: int = 256


class PointMaps(NamedTuple):
    """Outputs of the 2D network for B crops, in pixels of the feature grid.

    Attributes:
        features: (B, C, G, G).
        vote_mean: (B, 9, 2).
        vote_covariance: (B, 9, 2, 2).
        K_grid: (B, 3, 3) camera of the grid.
    """

    features: Tensor
    vote_mean: Tensor
    vote_covariance: Tensor
    K_grid: Tensor


class PointVotes(NamedTuple):
    """Votes of the points.

    Attributes:
        candidates: (B, N, 9, 3) each point's votes in the crop's frame, m.
        log_error: (B, N, 9) logarithm of a vote's predicted error, in diameters.
        keypoints: (B, 9, 3) in the camera's frame, m.
        covariance: (B, 9, 3, 3) of the votes for each keypoint, camera's frame, m^2.
    """

    candidates: Tensor
    log_error: Tensor
    keypoints: Tensor
    covariance: Tensor


class PointVotingNet(nn.Module):
    """Keypoints of ``objects`` objects from points with 2D features of ``channels`` channels."""

    def __init__(self, objects: int, channels: int, config: PointConfig = PointConfig()):
        super().__init__()
        self.config = config
        width, outputs = config.width, _OUTPUTS * KEYPOINTS
        self.embedding = nn.Embedding(objects, 64)
        self.film = nn.Linear(64, 2 * width)
        nn.init.zeros_(self.film.weight)
        nn.init.zeros_(self.film.bias)
        layer = partial(ConvBlock, kernel=1)  # for each point alone, on (B, C, N, 1)
        self.first = layer(channels + 3 + 3 * KEYPOINTS, width)
        self.second = layer(width, width)
        self.cloud = layer(width, config.pooled)
        self.whole = nn.Linear(config.pooled, width)
        self.joined = nn.Conv2d(width, width, 1, bias=False)
        self.norm = nn.BatchNorm2d(width)
        self.last = layer(width, width)
        self.head_weight = nn.Parameter(0.1 * torch.randn(objects, outputs, width) * width**-0.5)
        bias = torch.zeros(objects, KEYPOINTS, _OUTPUTS)
        bias[..., 4] = _INITIAL_VOTE_LOGIT
        self.head_bias = nn.Parameter(bias.flatten(1))

    def forward(
        self, maps: PointMaps, cloud: PointCloud, objects: Tensor, diameter: Tensor
    ) -> PointVotes:
        """Votes for the keypoints of ``objects`` (B,) int64; ``diameter`` is (B,) m.

        Computes in float32 also under autocast.
        """
        with torch.autocast(cloud.xyz.device.type, enabled=False):
            across, spread = self._to_votes(maps, cloud, diameter)
            raw = self._per_point(maps, cloud, objects, diameter, across, spread)
            from_votes = across * torch.sigmoid(raw[..., 4:])
            offset = raw[..., :3] + F.pad(from_votes, (0, 1))
            candidates = cloud.xyz[:, :, None] + diameter[:, None, None, None] * offset
            log_error = _MIN_LOG_ERROR + (_MAX_LOG_ERROR - _MIN_LOG_ERROR) * torch.sigmoid(
                raw[..., 3]
            )
            mean, covariance = robust_mean(candidates, log_error, cloud.valid, diameter)
            R = cloud.R_crop_cam
            return PointVotes(
                candidates=candidates,
                log_error=log_error,
                keypoints=mean @ R,
                covariance=R.mT[:, None] @ covariance @ R[:, None],
            )

    def _per_point(
        self,
        maps: PointMaps,
        cloud: PointCloud,
        objects: Tensor,
        diameter: Tensor,
        across: Tensor,
        spread: Tensor,
    ) -> Tensor:
        """The network's output (B, N, 9, 5)."""
        side = maps.features.shape[-1]
        grid = cloud.pixels[:, :, None] * (2 / (side - 1)) - 1
        sampled = F.grid_sample(
            maps.features.float(), grid, padding_mode="border", align_corners=True
        )
        shape = (cloud.xyz - cloud.center[:, None]) / diameter[:, None, None]
        seen = torch.cat([shape, across.flatten(2), spread.expand(*shape.shape[:2], -1)], -1)
        x = self.first(torch.cat([sampled, seen.mT[..., None]], 1))
        scale, shift = self.film(self.embedding(objects))[..., None, None].chunk(2, 1)
        x = self.second(x * (1 + scale) + shift)
        pooled = self.cloud(x).masked_fill(~cloud.valid[:, None, :, None], 0).amax((2, 3))
        x = self.joined(x) + self.whole(pooled)[..., None, None]
        x = self.last(F.relu(self.norm(x)))
        out = torch.baddbmm(
            self.head_bias[objects].unsqueeze(2), self.head_weight[objects], x[..., 0]
        )
        return out.mT.unflatten(-1, (KEYPOINTS, _OUTPUTS))

    @staticmethod
    def _to_votes(maps: PointMaps, cloud: PointCloud, diameter: Tensor) -> tuple[Tensor, Tensor]:
        """Offsets (B, N, 9, 2) across from each point to the ray of each 2D vote, and the logarithm
        of the votes' spread (B, 1, 9), both in diameters."""
        backward = cloud.R_crop_cam @ torch.linalg.inv(maps.K_grid)
        rays = F.pad(maps.vote_mean, (0, 1), value=1.0) @ backward.mT
        rays = rays[..., :2] / rays[..., 2:].clamp(min=0.1)
        across = cloud.xyz[:, :, None, 2:] * rays[:, None] - cloud.xyz[:, :, None, :2]
        across = (across / diameter[:, None, None, None]).clamp(
            -_MAX_DISPLACEMENT, _MAX_DISPLACEMENT
        )
        focal = torch.linalg.det(maps.K_grid[:, :2, :2]).abs().sqrt()
        per_pixel = cloud.center[:, 2] / (focal * diameter)
        spread = torch.linalg.det(maps.vote_covariance).clamp(min=1e-8) ** 0.25
        return across, (spread * per_pixel[:, None]).clamp(1e-3, _MAX_DISPLACEMENT).log()[:, None]


def point_features(decoder: Tensor, mask: Tensor) -> Tensor:
    """Concatenates the 2D network's last map (B, W, G, G) and its mask (B, G, G)."""
    return torch.cat([decoder.float(), mask[:, None]], 1)


def robust_mean(
    candidates: Tensor, log_error: Tensor, valid: Tensor, diameter: Tensor
) -> tuple[Tensor, Tensor]:
    """Robust mean (B, 9, 3) and covariance (B, 9, 3, 3) of the votes (Geman-McClure IRLS).

    A vote is weighted by the inverse square of its predicted error (that of Laplace's
    distribution; DenseFusion's confidence is its inverse).

    Args:
        candidates: (B, N, 9, 3) votes, m.
        log_error: (B, N, 9).
        valid: (B, N) which points vote. With none, all do.
        diameter: (B,) m.
    """
    empty = ~valid.any(1)
    valid_or_all = (valid | empty[:, None])[..., None]
    weight = torch.softmax((-2 * log_error).masked_fill(~valid_or_all, -torch.inf), 1)
    mean = torch.einsum("bnk,bnki->bki", weight, candidates)
    for _ in range(_ITERATIONS):
        squared = (candidates - mean[:, None]).square().sum(-1)
        inlier = 1 / (1 + squared / (_OUTLIER_SCALE * diameter[:, None, None]) ** 2) ** 2
        kept = weight * inlier + 1e-12 * valid_or_all
        kept = kept / kept.sum(1, keepdim=True)
        mean = torch.einsum("bnk,bnki->bki", kept, candidates)
    deviation = candidates - mean[:, None]
    covariance = torch.einsum("bnk,bnki,bnkj->bkij", kept, deviation, deviation)
    return mean, covariance
