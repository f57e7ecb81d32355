"""The voxel volume of Mid-Fusion: features of all views, lifted to 3D.

The volume's axes are parallel to the reference camera's; it is centered on an estimate of the
object's center. Each voxel samples the features at its projections in the views (outside an image:
a learned value); a 3D CNN computes a distribution over the voxels for each keypoint, whose
expectation is the keypoint. A coarse volume locates the object, a fine one inside it the keypoints.

A volume may also lift each view's 2D evidence: the likelihood of its votes at each voxel. The 3D
CNN then corrects a probabilistic triangulation.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .features import KEYPOINTS

_MIN_EVIDENCE = 1e-3
"""Smallest likelihood of a voxel: a vote may be wrong."""

_VOXEL_STD = 0.4
"""Standard deviation in voxels that the extent of a voxel adds to a vote."""


@dataclass(frozen=True)
class LevelConfig:
    """Size of one volume.

    Attributes:
        cells: voxels along each side; None: given by ``cell_size``.
        half_size: half the side in object diameters, or in meters where ``metric``.
        metric: whether ``half_size`` is in meters.
        cell_size: side of a voxel in meters, where ``cells`` is None.
    """

    cells: int | None
    half_size: float
    metric: bool = False
    cell_size: float | None = None

    def shape(self, diameter: Tensor) -> tuple[int, Tensor]:
        """Voxels along a side, and half the side in meters (B,), for objects of a diameter (B,)."""
        half = (
            torch.full_like(diameter, self.half_size) if self.metric else diameter * self.half_size
        )
        if self.cells is not None:
            return self.cells, half
        assert self.cell_size is not None
        count = math.ceil(2 * float(half.max()) / self.cell_size)
        # The voxel size is fixed, so all volumes of a batch are as large as the largest.
        return count, torch.full_like(half, count * self.cell_size / 2)


@dataclass(frozen=True)
class VolumeConfig:
    """Both volumes and the 3D network.

    Attributes:
        coarse: the first volume, around the initial center.
        fine: the second volume, around the coarse result.
        hidden: channels of the 3D network.
        evidence: whether the views' votes are lifted too.
        coarse_pose: whether the coarse volume's pose is part of the training's loss.
        solver: from the volume's keypoints to the pose, in training and by default after it.
        predicted_first: whether the loss of the distributions is D(predicted || true), not
            D(true || predicted).
    """

    coarse: LevelConfig = LevelConfig(cells=14, half_size=1.0)
    fine: LevelConfig = LevelConfig(cells=16, half_size=0.65)
    hidden: int = 32
    evidence: bool = True
    coarse_pose: bool = False
    solver: str = "soft"
    predicted_first: bool = False


PRESETS = {
    "fast": VolumeConfig(),
    "features": VolumeConfig(evidence=False),
    "paper": VolumeConfig(
        coarse=LevelConfig(cells=60, half_size=0.3, metric=True),
        fine=LevelConfig(cells=None, half_size=0.65, cell_size=0.005),
        evidence=False,
        coarse_pose=True,
        solver="soft-mean",
        predicted_first=True,
    ),
}
"""``paper`` is the paper's: +-0.3 m in voxels of 0.01 m, then the object in voxels of 0.005 m, from
features alone, both levels' poses in the loss, and the KL divergence in its direction. ``fast`` is
the default; ``features`` is the same without the votes: what the features alone can do."""


class ViewMaps(NamedTuple):
    """Inputs from V views of B samples, the reference view first.

    Attributes:
        features: (B, V, C, G, G).
        projection: (B, V, 3, 4), from the reference camera's frame to pixels of the feature grid.
        vote_mean: (B, V, 9, 2), pixels of the feature grid.
        vote_covariance: (B, V, 9, 2, 2).
    """

    features: Tensor
    projection: Tensor
    vote_mean: Tensor
    vote_covariance: Tensor


class LevelOutput(NamedTuple):
    """Output of one volume, in the reference camera's frame.

    Attributes:
        log_probability: (B, 9, N^3).
        cells: (B, N^3, 3) centers of the voxels, m.
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
    """One volume with its 3D network; ``channels`` are those of the lifted feature maps."""

    def __init__(self, channels: int, config: VolumeConfig):
        super().__init__()
        self.evidence = config.evidence
        self.outside = nn.Parameter(torch.zeros(channels))
        inputs = 2 * channels + (2 * KEYPOINTS if config.evidence else 0)
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
            nn.init.normal_(self.output.weight, std=0.01)
            assert self.output.bias is not None
            nn.init.zeros_(self.output.bias)

    def forward(
        self, views: ViewMaps, center: Tensor, level: LevelConfig, diameter: Tensor
    ) -> LevelOutput:
        """Finds the keypoints in a volume around ``center`` (B, 3); ``diameter`` is (B,)."""
        count, half = level.shape(diameter)
        cell_size = 2 * half / count
        # Only the convolutions run in bfloat16: at a meter its steps are 8 mm.
        with torch.autocast(center.device.type, enabled=False):
            cells = voxel_centers(center, half, count)
            lifted, evidence = lift(views, cells, cell_size, self.outside, self.evidence)
        # The paper concatenates two views; further ones are averaged with the second.
        others = lifted[:, 1:].mean(1) if lifted.shape[1] > 1 else lifted[:, 0]
        parts = [lifted[:, 0], others]
        if evidence is not None:
            parts += [evidence[:, 0], evidence[:, 1:].sum(1)]
        x = torch.cat(parts, 1)
        x = x.reshape(*x.shape[:2], count, count, count)
        x = self.output(self.trunk(to_conv_layout(x)))
        with torch.autocast(center.device.type, enabled=False):
            logits = x.reshape(*x.shape[:2], -1).float()
            if evidence is not None:
                logits = logits + evidence.sum(1)
            log_probability = F.log_softmax(logits, -1)
            probability = log_probability.exp()
            keypoints = probability @ cells
            deviation = cells[:, None] - keypoints[:, :, None]
            covariance = torch.einsum("bkn,bkni,bknj->bkij", probability, deviation, deviation)
        return LevelOutput(log_probability, cells, cell_size, keypoints, covariance)


class VolumeNet(nn.Module):
    """The coarse, then the fine volume; ``channels`` are those of the lifted feature maps."""

    def __init__(self, channels: int, config: VolumeConfig = PRESETS["fast"]):
        super().__init__()
        self.config = config
        self.coarse = Volume(channels, config)
        self.fine = Volume(channels, config)

    def forward(self, views: ViewMaps, guess: Tensor, diameter: Tensor) -> list[LevelOutput]:
        """Computes the coarse and the fine output.

        Args:
            views: their features, cameras and votes.
            guess: (B, 3) the object's initial center in the reference camera, m.
            diameter: (B,) m.
        """
        coarse = self.coarse(views, guess, self.config.coarse, diameter)
        center = coarse.keypoints[:, -1].detach()
        return [coarse, self.fine(views, center, self.config.fine, diameter)]


def to_conv_layout(x: Tensor) -> Tensor:
    """Converts a volume (B, C, N, N, N) to the convolutions' memory format and dtype at once."""
    device = x.device.type
    reduced = torch.is_autocast_enabled(device)
    dtype = torch.get_autocast_dtype(device) if reduced else x.dtype
    return x.to(dtype, memory_format=torch.channels_last_3d)


def voxel_centers(center: Tensor, half: Tensor, count: int) -> Tensor:
    """Centers (B, count^3, 3) of the voxels of cubes of half side ``half`` (B,) around (B, 3)."""
    steps = torch.arange(count, dtype=center.dtype, device=center.device)
    steps = (steps + 0.5) / count * 2 - 1
    grid = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    return center[:, None] + grid * half[:, None, None]


def lift(
    views: ViewMaps, cells: Tensor, cell_size: Tensor, outside: Tensor, with_evidence: bool
) -> tuple[Tensor, Tensor | None]:
    """Samples every view at the projections of voxels.

    Args:
        views: their features, cameras and votes.
        cells: (B, N, 3) in the reference camera's frame, m.
        cell_size: (B,) side of a voxel, m.
        outside: (C,) features of voxels that project outside a view.
        with_evidence: whether to lift the votes as well.

    Returns:
        Features (B, V, C, N) and evidence (B, V, 9, N) or None: log-likelihoods up to a constant.
    """
    batch, count, channels, side, _ = views.features.shape
    P = views.projection
    uvw = torch.einsum("bvij,bnj->bvni", P[..., :3], cells) + P[..., 3].unsqueeze(2)
    pixels = uvw[..., :2] / uvw[..., 2:].clamp(min=0.05)
    grid = pixels * (2.0 / (side - 1)) - 1.0
    features = views.features.float()  # bfloat16 is too coarse for sampling positions
    sampled = F.grid_sample(
        features.reshape(batch * count, channels, side, side),
        grid.reshape(batch * count, 1, -1, 2),
        mode="bilinear",
        padding_mode="border",
        align_corners=True,
    ).reshape(batch, count, channels, -1)
    inside = (grid.abs().amax(-1) <= 1.0) & (uvw[..., 2] > 0.05)
    sampled = torch.where(
        inside.unsqueeze(2), sampled, outside.to(sampled.dtype)[None, None, :, None]
    )
    if not with_evidence:
        return sampled, None
    covariance = views.vote_covariance + _footprint(P, cells.mean(1), cell_size).unsqueeze(2)
    precision = torch.linalg.inv(covariance)
    offset = pixels.unsqueeze(2) - views.vote_mean.unsqueeze(3)
    x, y = offset[..., 0], offset[..., 1]
    distance = (
        precision[..., 0, 0, None] * x * x
        + 2 * precision[..., 0, 1, None] * x * y
        + precision[..., 1, 1, None] * y * y
    )
    evidence = torch.log(torch.exp(-0.5 * distance) + _MIN_EVIDENCE)
    return sampled, evidence.to(sampled.dtype)


def _footprint(projection: Tensor, center: Tensor, cell_size: Tensor) -> Tensor:
    """Covariance (B, V, 2, 2) of a voxel's projection, for voxels near ``center`` (B, 3).

    Without it, a vote narrower than a voxel would fall between voxel centers.
    """
    uvw = torch.einsum("bvij,bj->bvi", projection[..., :3], center) + projection[..., 3]
    depth = uvw[..., 2:].clamp(min=0.05)
    pixel = uvw[..., :2] / depth
    rows = projection[..., :2, :3] - pixel.unsqueeze(-1) * projection[..., 2:, :3]
    jacobian = rows * (_VOXEL_STD * cell_size[:, None, None] / depth).unsqueeze(-1)
    return jacobian @ jacobian.transpose(-1, -2)
