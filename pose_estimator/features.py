"""2D features of a crop: the part that all fusion strategies share.

A multi-scale CNN gives, for the object that is asked for, its segmentation and, at each pixel, unit
vectors towards its nine keypoints (Peng et al., "PVNet", CVPR 2019), and the feature map that
Mid-Fusion lifts into its volume. One network serves all objects: the object's embedding modulates
the decoder (FiLM, Perez et al., AAAI 2018), and the last layer has weights of each object's own, of
which only those of the asked object are computed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .encoder import Encoder

KEYPOINTS = 9


@dataclass(frozen=True)
class FeatureConfig:
    """Shape of the 2D network.

    Attributes:
        crop: side of the crop in pixels, a multiple of 32.
        stride: pixels of the crop per pixel of the output maps.
        roi_scale: side of the region of interest in object diameters.
        width: channels of the decoder at the output resolution.
        volume_channels: channels of the map that Mid-Fusion lifts.
    """

    crop: int = 128
    stride: int = 4
    roi_scale: float = 1.4
    width: int = 64
    volume_channels: int = 32

    @property
    def grid(self) -> int:
        """Side of the output maps."""
        return self.crop // self.stride


class Features2D(NamedTuple):
    """Output of the 2D network for B crops; maps are G x G at the stride of the configuration.

    Attributes:
        mask_logits: (B, G, G), the visible part of the object.
        directions: (B, 9, 2, G, G), raw vectors (x, y) towards each keypoint. They are trained to
            unit length, and shrink where the network is unsure.
        volume: (B, C, G, G), features for the volume.
        decoder: (B, W, G, G), the decoder's last map, of which the others are projections.
    """

    mask_logits: Tensor
    directions: Tensor
    volume: Tensor
    decoder: Tensor


class ConvBlock(nn.Sequential):
    """3x3 convolution, batch norm, ReLU."""

    def __init__(self, inputs: int, outputs: int):
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, padding=1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


class CoordinateConv(nn.Module):
    """A 1x1 convolution of the pixels' coordinates, to be added to a feature map.

    Liu et al., "An intriguing failing of convolutional neural networks and the CoordConv solution",
    NeurIPS 2018: a vector towards a keypoint depends on where the pixel is, which convolutions do
    not see.
    """

    def __init__(self, outputs: int):
        super().__init__()
        self.project = nn.Conv2d(2, outputs, 1, bias=False)
        nn.init.zeros_(self.project.weight)

    def forward(self, x: Tensor) -> Tensor:
        height, width = x.shape[2:]
        rows, columns = torch.linspace(-1, 1, height), torch.linspace(-1, 1, width)
        grid = torch.stack(torch.meshgrid(columns, rows, indexing="xy"))
        return x + self.project(grid[None]).to(x.dtype)


class Refinement(nn.Module):
    """A residual block that starts as the identity."""

    def __init__(self, channels: int):
        super().__init__()
        self.block = ConvBlock(channels, channels)
        self.output = nn.Conv2d(channels, channels, 1)
        for parameter in self.output.parameters():
            nn.init.zeros_(parameter)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.output(self.block(x))


class KeypointNet(nn.Module):
    """The shared 2D network.

    Args:
        objects: how many objects it knows.
        config: its shape.
    """

    def __init__(self, objects: int, config: FeatureConfig = FeatureConfig()):
        super().__init__()
        self.config = config
        width = config.width
        self.encoder = Encoder(6)
        c4, c8, c16, c32 = self.encoder.channels
        self.embedding = nn.Embedding(objects, 64)
        self.bottleneck = ConvBlock(c32, 128)
        self.up16 = ConvBlock(128 + c16, 128)
        self.up8 = ConvBlock(128 + c8, 96)
        self.up4 = ConvBlock(96 + c4, width)
        self.film16 = nn.Linear(64, 2 * 128)
        self.film4 = nn.Linear(64, 2 * width)
        for film in (self.film16, self.film4):
            nn.init.zeros_(film.weight)
            nn.init.zeros_(film.bias)
        self.trunk = ConvBlock(width, width)
        self.coordinates8 = CoordinateConv(96)
        self.coordinates4 = CoordinateConv(width)
        self.refine8 = Refinement(96)
        self.refine4 = Refinement(width)
        self.volume_head = nn.Conv2d(width, config.volume_channels, 1)
        outputs = 1 + 2 * KEYPOINTS
        self.head_weight = nn.Parameter(torch.randn(objects, outputs, width) * width**-0.5)
        self.head_bias = nn.Parameter(torch.zeros(objects, outputs))

    def forward(self, crops: Tensor, objects: Tensor) -> Features2D:
        """Features of crops.

        Args:
            crops: (B, 3, S, S), RGB in 0..255 as floats.
            objects: (B,) int64, the index of the object asked for in each crop.

        Returns:
            Maps of side S / 4.
        """
        return self.decode(self.encoder.pyramid(crops), objects)

    def decode(self, pyramid: Sequence[Tensor], objects: Tensor) -> Features2D:
        """Features from the encoder's maps at strides 2 to 32; see :meth:`forward`."""
        _, f4, f8, f16, f32 = pyramid
        embedding = self.embedding(objects)
        x = self.up16(torch.cat([_twice(self.bottleneck(f32)), f16], 1))
        x = _modulate(x, self.film16(embedding))
        x = self.up8(torch.cat([_twice(x), f8], 1))
        x = self.refine8(self.coordinates8(x))
        x = self.up4(torch.cat([_twice(x), f4], 1))
        x = self.trunk(self.coordinates4(_modulate(x, self.film4(embedding))))
        x = self.refine4(x)
        batch, width, height, breadth = x.shape
        maps = torch.baddbmm(
            self.head_bias[objects].to(x.dtype).unsqueeze(2),
            self.head_weight[objects].to(x.dtype),
            x.reshape(batch, width, height * breadth),
        ).reshape(batch, -1, height, breadth)
        return Features2D(
            mask_logits=maps[:, 0],
            directions=maps[:, 1:].reshape(batch, KEYPOINTS, 2, height, breadth),
            volume=self.volume_head(x),
            decoder=x,
        )


def _twice(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


def _modulate(x: Tensor, film: Tensor) -> Tensor:
    scale, shift = film.to(x.dtype)[:, :, None, None].chunk(2, 1)
    return x * (1 + scale) + shift
