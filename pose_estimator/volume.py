"""The voxel volume of Mid-Fusion: features of all views, lifted to where they meet in space.

The volume's axes are parallel to the reference camera's and it is centred on a guess of the
object's centre. Each voxel takes the features that its projections find in the views (outside a
picture: a learned initial value); a 3D CNN turns them into one distribution over the voxels for
each keypoint, and a keypoint is the distribution's expectation. A coarse volume finds the object,
a fine one inside it finds the keypoints.

Beside the features a volume may lift evidence: how likely the votes of each view, and the pose that
explains the votes of all views at once, make each voxel to be the keypoint. The 3D CNN then starts
from probabilistic triangulation of a rigid object and corrects it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .features import KEYPOINTS
from .lifting import KeypointPrior, ViewMaps, lift, prior_evidence, voxel_centres


@dataclass(frozen=True)
class LevelConfig:
    """Size of one volume.

    Attributes:
        cells: voxels along each side, or None to let ``cell_size`` decide.
        half_size: half the side in object diameters, or in metres where ``metric``.
        metric: whether ``half_size`` is in metres.
        cell_size: side of a voxel in metres, where ``cells`` is None.
    """

    cells: int | None
    half_size: float
    metric: bool = False
    cell_size: float | None = None

    def shape(self, diameter: Tensor) -> tuple[int, Tensor]:
        """Voxels along a side, and half the side in metres (B,), for objects of a diameter (B,)."""
        half = (
            torch.full_like(diameter, self.half_size) if self.metric else diameter * self.half_size
        )
        if self.cells is not None:
            return self.cells, half
        assert self.cell_size is not None
        count = math.ceil(2 * float(half.max()) / self.cell_size)
        # Voxels keep their size, so in a batch all volumes are as large as the largest.
        return count, torch.full_like(half, count * self.cell_size / 2)


@dataclass(frozen=True)
class VolumeConfig:
    """Both volumes and the 3D network.

    Attributes:
        coarse: the first volume, around the guess.
        fine: the second volume, around the coarse answer.
        hidden: channels of the 3D network.
        evidence: whether votes, and the pose that explains them, are lifted beside the features.
        coarse_pose: whether the coarse volume's pose is part of the training's loss.
    """

    coarse: LevelConfig = LevelConfig(cells=14, half_size=1.0)
    fine: LevelConfig = LevelConfig(cells=16, half_size=0.65)
    hidden: int = 32
    evidence: bool = True
    coarse_pose: bool = False


PRESETS = {
    "fast": VolumeConfig(),
    "paper": VolumeConfig(
        coarse=LevelConfig(cells=60, half_size=0.3, metric=True),
        fine=LevelConfig(cells=None, half_size=0.65, cell_size=0.005),
        evidence=False,
        coarse_pose=True,
    ),
}
"""``paper`` is the paper's: +-0.3 m in voxels of 0.01 m, then the object in voxels of 0.005 m, from
features alone, and both levels' poses in the loss. ``fast`` is the default."""


class LevelOutput(NamedTuple):
    """What one volume says, in the reference camera's frame.

    Attributes:
        log_probability: (B, 9, N^3).
        cells: (B, N^3, 3) centres of the voxels, m.
        cell_size: (B,) m.
        keypoints: (B, 9, 3) expectations, m.
        covariance: (B, 9, 3, 3) of the distributions, m^2.
    """

    log_probability: Tensor
    cells: Tensor
    cell_size: Tensor
    keypoints: Tensor
    covariance: Tensor


class Volume(nn.Module):
    """One volume with its 3D network: three convolutions and an output convolution.

    Args:
        channels: of the lifted feature maps.
        config: both volumes' configuration.
    """

    def __init__(self, channels: int, config: VolumeConfig):
        super().__init__()
        self.evidence = config.evidence
        self.outside = nn.Parameter(torch.zeros(channels))
        inputs = 2 * channels + (3 * KEYPOINTS if config.evidence else 0)
        layers: list[nn.Module] = []
        for width in (inputs, config.hidden, config.hidden):
            layers += [
                nn.Conv3d(width, config.hidden, 3, padding=1, bias=False),
                nn.BatchNorm3d(config.hidden),
                nn.ReLU(inplace=True),
            ]
        self.trunk = nn.Sequential(*layers)
        self.output = nn.Conv3d(config.hidden, KEYPOINTS, 3, padding=1)
        if config.evidence:
            # How far the evidence is believed that the convolutions correct: the votes of the
            # reference, those of the others, and the joint pose, which knows both already.
            self.trust = nn.Parameter(torch.tensor([0.5, 0.5, 1.0]))
            nn.init.normal_(self.output.weight, std=0.01)
            assert self.output.bias is not None
            nn.init.zeros_(self.output.bias)

    def forward(
        self,
        views: ViewMaps,
        prior: KeypointPrior,
        centre: Tensor,
        level: LevelConfig,
        diameter: Tensor,
    ) -> LevelOutput:
        """Finds the keypoints in a volume around ``centre`` (B, 3); ``diameter`` is (B,)."""
        count, half = level.shape(diameter)
        cell_size = 2 * half / count
        parts, believed = [], None
        # Only the convolutions bear bfloat16: at a metre its steps are 8 mm.
        with torch.autocast(centre.device.type, enabled=False):
            cells = voxel_centres(centre, half, count)
            lifted, votes = lift(views, cells, cell_size, self.outside, self.evidence)
            # The paper concatenates two views; further ones share the second's place.
            others = lifted[:, 1:].mean(1) if lifted.shape[1] > 1 else lifted[:, 0]
            parts += [lifted[:, 0], others]
            if votes is not None:
                joint = prior_evidence(prior, cells, cell_size, diameter)
                evidence = torch.stack([votes[:, 0], votes[:, 1:].sum(1), joint], 1)
                parts.append(evidence.flatten(1, 2))
                believed = (self.trust[:, None, None] * evidence).sum(1)
        x = torch.cat(parts, 1)
        x = x.reshape(*x.shape[:2], count, count, count)
        x = self.output(self.trunk(x.contiguous(memory_format=torch.channels_last_3d)))
        with torch.autocast(centre.device.type, enabled=False):
            logits = x.reshape(*x.shape[:2], -1).float()
            if believed is not None:
                logits = logits + believed
            log_probability = F.log_softmax(logits, -1)
            probability = log_probability.exp()
            keypoints = probability @ cells
            deviation = cells[:, None] - keypoints[:, :, None]
            covariance = torch.einsum("bkn,bkni,bknj->bkij", probability, deviation, deviation)
        return LevelOutput(log_probability, cells, cell_size, keypoints, covariance)


class VolumeNet(nn.Module):
    """Coarse, then fine.

    Args:
        channels: of the lifted feature maps.
        config: both volumes.
    """

    def __init__(self, channels: int, config: VolumeConfig = PRESETS["fast"]):
        super().__init__()
        self.config = config
        self.coarse = Volume(channels, config)
        self.fine = Volume(channels, config)

    def forward(
        self, views: ViewMaps, prior: KeypointPrior, diameter: Tensor, guess: Tensor | None = None
    ) -> list[LevelOutput]:
        """Finds the keypoints.

        Args:
            views: what the views bring.
            prior: the keypoints of the pose that explains all votes.
            diameter: (B,) m.
            guess: (B, 3) the object's centre in the reference camera, m, around which the coarse
                volume lies; none = where ``prior`` has it.

        Returns:
            The coarse and the fine answer.
        """
        guess = prior.mean[:, -1] if guess is None else guess
        coarse = self.coarse(views, prior, guess, self.config.coarse, diameter)
        centre = coarse.keypoints[:, -1].detach()
        return [coarse, self.fine(views, prior, centre, self.config.fine, diameter)]
