"""A U-Net decoder, shared by all objects or one for each.

The shared decoder is conditioned on the object's embedding (FiLM, Perez et al., AAAI 2018) and
trained first; but thirteen objects exceed its capacity: its error on training crops is as large as
on others, and 400 batches of one object alone, on the same encoder, reduced that object's error by
a quarter. So in the end each object has its own decoder, initialized from the shared one; PVNet has
a whole network for each object.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class ConvBlock(nn.Sequential):
    """Convolution (3x3 by default), batch norm, ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3):
        super().__init__(
            nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


class CoordinateConv(nn.Module):
    """Adds a 1x1 convolution of the pixels' coordinates to a feature map.

    Liu et al., "An intriguing failing of convolutional neural networks and the CoordConv solution",
    NeurIPS 2018: a vector to a keypoint depends on the pixel's position.
    """

    def __init__(self, outputs: int):
        super().__init__()
        self.project = nn.Conv2d(2, outputs, 1, bias=False)
        nn.init.zeros_(self.project.weight)

    def forward(self, x: Tensor) -> Tensor:
        height, width = x.shape[2:]
        rows = torch.linspace(-1, 1, height, device=x.device)
        columns = torch.linspace(-1, 1, width, device=x.device)
        grid = torch.stack(torch.meshgrid(columns, rows, indexing="xy"))
        return x + self.project(grid[None]).to(x.dtype)


class Refinement(nn.Module):
    """A residual block, initialized to the identity."""

    def __init__(self, channels: int):
        super().__init__()
        self.block = ConvBlock(channels, channels)
        self.output = nn.Conv2d(channels, channels, 1)
        for parameter in self.output.parameters():
            nn.init.zeros_(parameter)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.output(self.block(x))


class Decoder(nn.Module):
    """The upsampling half of a U-Net, from stride 32 to stride 4.

    Args:
        encoder: channels of the encoder's maps at strides 4 to 32.
        width: channels at stride 4.
        volume_channels: of the map that Mid-Fusion lifts.
    """

    WIDTH16 = 128
    """Channels at stride 16."""

    def __init__(self, encoder: Sequence[int], width: int, volume_channels: int):
        super().__init__()
        c4, c8, c16, c32 = encoder
        self.bottleneck = ConvBlock(c32, 128)
        self.up16 = ConvBlock(128 + c16, self.WIDTH16)
        self.up8 = ConvBlock(self.WIDTH16 + c8, 96)
        self.up4 = ConvBlock(96 + c4, width)
        self.trunk = ConvBlock(width, width)
        self.coordinates8 = CoordinateConv(96)
        self.coordinates4 = CoordinateConv(width)
        self.refine8 = Refinement(96)
        self.refine4 = Refinement(width)
        self.volume_head = nn.Conv2d(width, volume_channels, 1)

    def forward(
        self, pyramid: Sequence[Tensor], film16: Tensor, film4: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Decodes B crops.

        Args:
            pyramid: the encoder's maps at strides 4, 8, 16 and 32.
            film16: (B, 2 * 128) scales (minus one) and shifts at stride 16.
            film4: (B, 2 * width) at stride 4.

        Returns:
            The last map (B, width, G, G) and the map to lift (B, volume_channels, G, G).
        """
        f4, f8, f16, f32 = pyramid
        x = self.up16(torch.cat([_upsample(self.bottleneck(f32)), f16], 1))
        x = _modulate(x, film16)
        x = self.up8(torch.cat([_upsample(x), f8], 1))
        x = self.refine8(self.coordinates8(x))
        x = self.up4(torch.cat([_upsample(x), f4], 1))
        x = self.trunk(self.coordinates4(_modulate(x, film4)))
        x = self.refine4(x)
        return x, self.volume_head(x)


def _upsample(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


def _modulate(x: Tensor, film: Tensor) -> Tensor:
    scale, shift = film.to(x.dtype)[:, :, None, None].chunk(2, 1)
    return x * (1 + scale) + shift
