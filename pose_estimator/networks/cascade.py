"""The cascade cost volume of Early-Fusion: the reference view's depth map from two or more views.

Gu et al., "Cascade cost volume for high-resolution multi-view stereo and stereo matching", CVPR
2020 (Cas-MVSNet). Three stages sweep planes through the scene. Each builds a cost volume by
group-wise correlation of the views, filters it with a small 3D U-Net, and takes the expectation
over the depth hypotheses (soft argmin). The hypotheses of a stage are around the depths of the one
before it, in a narrower range and on a finer grid; the last spacing is 3.5 mm, as in the paper.

The features are a pyramid (Lin et al., CVPR 2017) on the frozen encoder that all methods share.
Unlike Cas-MVSNet's, the U-Net also sees the reference's own features and each hypothesis' position
in its range, for surfaces without texture and for short baselines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ...core.geometry import grid_matrix
from .decoder import ConvBlock
from .encoder import PYRAMID_CHANNELS
from .plane_sweep import group_correlation, sweep

_MIN_DEPTH = 0.1
"""Smallest depth hypothesis in meters."""

_MIN_HALF_RANGE = 0.15
_HALF_RANGE = 1.0
"""Half the first range: the larger of so many meters and so many diameters."""


@dataclass(frozen=True)
class CascadeLevel:
    """One stage.

    Attributes:
        stride: pixels of the crop per pixel of the stage's map: 2, 4 or 8.
        planes: number of depth hypotheses, a multiple of 4.
        spacing: meters between them; None: given by the object's diameter.
    """

    stride: int
    planes: int
    spacing: float | None


@dataclass(frozen=True)
class CascadeConfig:
    """Shape of the cascade.

    Attributes:
        levels: the stages, from coarse to fine.
        channels: of the features, at strides 8, 4 and 2.
        groups: of the correlation, a divisor of each of ``channels``.
        hidden: channels of the 3D networks.
    """

    levels: tuple[CascadeLevel, ...] = (
        CascadeLevel(8, 48, None),
        CascadeLevel(4, 16, 0.007),
        CascadeLevel(2, 8, 0.0035),
    )
    channels: tuple[int, int, int] = (32, 32, 16)
    groups: int = 8
    hidden: int = 16


class CascadeViews(NamedTuple):
    """Inputs from V >= 2 views of B samples, the reference view first.

    Attributes:
        maps: the encoder's pyramid of the crops, (B, V, C, G, G) at strides 2, 4, 8 and 16.
        K: (B, V, 3, 3) cameras of the crops (stride 1).
        T_view_ref: (B, V, 4, 4) from the reference camera to each, m.
    """

    maps: tuple[Tensor, ...]
    K: Tensor
    T_view_ref: Tensor


class DepthOutput(NamedTuple):
    """Output of one stage for the reference view, on its grid.

    Attributes:
        depth: (B, H, W) expectations, m.
        variance: (B, H, W) of the distributions, m^2.
        center: (B, H, W) middles of the searched ranges, m.
        half_range: (B,) from the middle to the ends, m.
        stride: pixels of the crop per pixel of the grid.
    """

    depth: Tensor
    variance: Tensor
    center: Tensor
    half_range: Tensor
    stride: int


class FeaturePyramid(nn.Module):
    """Top-down features from the encoder's maps; ``channels`` are those at strides 8, 4 and 2."""

    def __init__(self, channels: Sequence[int]):
        super().__init__()
        widest = max(channels)
        self.lateral = nn.ModuleList(nn.Conv2d(c, widest, 1) for c in PYRAMID_CHANNELS[3::-1])
        self.smooth = nn.ModuleList(ConvBlock(widest, widest) for _ in channels)
        self.output = nn.ModuleList(nn.Conv2d(widest, c, 1) for c in channels)

    def forward(self, maps: Sequence[Tensor]) -> dict[int, Tensor]:
        """Features (N, C, G, G) by their stride, from maps (N, C, G, G) at strides 2 to 16."""
        x = self.lateral[0](maps[3])
        features = {}
        for number, (smooth, output) in enumerate(zip(self.smooth, self.output, strict=True)):
            x = F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
            x = smooth(x + self.lateral[number + 1](maps[2 - number]))
            features[8 >> number] = output(x)
        return features


class CostNet(nn.Module):
    """A 3D U-Net from a cost volume to one logit for each depth hypothesis.

    Args:
        inputs: channels of the cost volume.
        context: channels of the reference's features.
        hidden: channels at full resolution.
    """

    def __init__(self, inputs: int, context: int, hidden: int):
        super().__init__()
        self.inputs = nn.Conv3d(inputs, hidden, 3, padding=1, bias=False)
        # The same at all depths, hence a 2D convolution.
        self.context = nn.Conv2d(context, hidden, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm3d(hidden)
        self.fine = _block(hidden, hidden)
        self.down = _block(hidden, 2 * hidden, stride=2)
        self.middle = _block(2 * hidden, 2 * hidden)
        self.deep_down = _block(2 * hidden, 2 * hidden, stride=2)
        self.deep = _block(2 * hidden, 2 * hidden)
        self.deep_up = _block(2 * hidden, 2 * hidden)
        self.up = _block(2 * hidden, hidden)
        self.output = nn.Conv3d(hidden, 1, 3, padding=1)
        nn.init.normal_(self.output.weight, std=0.01)
        assert self.output.bias is not None
        nn.init.zeros_(self.output.bias)

    def forward(self, cost: Tensor, context: Tensor) -> Tensor:
        """Logits (B, D, H, W) from (B, inputs, D, H, W) and the reference's (B, C, H, W)."""
        x = self.inputs(cost.contiguous(memory_format=torch.channels_last_3d))
        x = F.relu(self.norm(x + self.context(context).unsqueeze(2)))
        x = self.fine(x)
        middle = self.middle(self.down(x))
        deep = self.deep(self.deep_down(middle))
        middle = middle + self.deep_up(F.interpolate(deep, scale_factor=2.0))
        x = x + self.up(F.interpolate(middle, scale_factor=2.0))
        return self.output(x)[:, 0]


class CascadeNet(nn.Module):
    """All stages of the cascade."""

    def __init__(self, config: CascadeConfig = CascadeConfig()):
        super().__init__()
        self.config = config
        self.pyramid = FeaturePyramid(config.channels)
        channels = dict(zip((8, 4, 2), config.channels, strict=True))
        # Two more channels: the share of views that show the point, and the hypothesis.
        self.costs = nn.ModuleList(
            CostNet(config.groups + 2, channels[level.stride], config.hidden)
            for level in config.levels
        )
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
            elif isinstance(module, nn.Conv3d):
                module.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]

    def forward(self, views: CascadeViews, guess: Tensor, diameter: Tensor) -> list[DepthOutput]:
        """Estimates the reference's depth.

        Args:
            views: the encoded crops and their cameras.
            guess: (B,) depth of the object's center in the reference camera, m.
            diameter: (B,) of the object, m.

        Returns:
            The stages' outputs, the finest last.
        """
        batch, count = views.K.shape[:2]
        features = {
            stride: f.unflatten(0, (batch, count))
            for stride, f in self.pyramid([m.flatten(0, 1) for m in views.maps]).items()
        }
        outputs: list[DepthOutput] = []
        for level, cost_net in zip(self.config.levels, self.costs, strict=True):
            maps = features[level.stride]
            # Only the convolutions run in bfloat16.
            with torch.autocast(guess.device.type, enabled=False):
                size = maps.shape[-2:]
                center = guess[:, None, None].expand(-1, *size)
                if outputs:
                    center = outputs[-1].depth.detach()[:, None]
                    center = F.interpolate(center, size, mode="bilinear")[:, 0]
                half = half_range(level, diameter)
                steps = torch.linspace(-1, 1, level.planes, device=guess.device)
                offsets = half[:, None] * steps
                depths = (center[:, None] + offsets[..., None, None]).clamp(min=_MIN_DEPTH)
                grid = torch.from_numpy(grid_matrix(level.stride)).to(views.K)
                cost = build_cost_volume(
                    maps, grid @ views.K, views.T_view_ref, depths, self.config.groups
                )
                hypothesis = steps[:, None, None].expand_as(depths[:, None])
                cost = torch.cat([cost, hypothesis], 1)
            logits = cost_net(cost, maps[:, 0])
            with torch.autocast(guess.device.type, enabled=False):
                probability = torch.softmax(logits.float(), 1)
                depth = (probability * depths).sum(1)
                variance = (probability * (depths - depth[:, None]).square()).sum(1)
            outputs.append(DepthOutput(depth, variance, center, half, level.stride))
        return outputs


def build_cost_volume(
    features: Tensor, K: Tensor, T_view_ref: Tensor, depths: Tensor, groups: int
) -> Tensor:
    """Builds the cost volume: the correlation of the views at depth hypotheses.

    Args:
        features: (B, V, C, H, W), the reference view first.
        K: (B, V, 3, 3) of the maps' pixels.
        T_view_ref: (B, V, 4, 4), m.
        depths: (B, D, H, W), m.
        groups: of channels.

    Returns:
        (B, groups + 1, D, H, W): correlation with the mean of the views that show the point, and
        the share of the views that do.
    """
    total = features.new_zeros((), dtype=torch.float32)
    seen = torch.zeros_like(total)
    for view in range(1, features.shape[1]):
        warped, inside = sweep(features[:, view], K[:, 0], K[:, view], T_view_ref[:, view], depths)
        shown = inside.unsqueeze(1).to(warped.dtype)
        total = total + group_correlation(features[:, 0], warped, groups) * shown
        seen = seen + shown
    return torch.cat([total / seen.clamp(min=1), seen / (features.shape[1] - 1)], 1)


def half_range(level: CascadeLevel, diameter: Tensor) -> Tensor:
    """Half the range (B,) in meters that a stage searches, for objects of a diameter (B,)."""
    if level.spacing is None:
        return (diameter * _HALF_RANGE).clamp(min=_MIN_HALF_RANGE)
    return torch.full_like(diameter, level.spacing * (level.planes - 1) / 2)


def _block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(inputs, outputs, 3, stride, padding=1, bias=False),
        nn.BatchNorm3d(outputs),
        nn.ReLU(inplace=True),
    )
