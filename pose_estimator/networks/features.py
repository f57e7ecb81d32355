"""2D features of a crop: the part that all fusion strategies share.

A multi-scale CNN gives, for the object that is asked for, its segmentation and, at each pixel, unit
vectors towards its nine keypoints (Peng et al., "PVNet", CVPR 2019), and the feature map that
Mid-Fusion lifts into its volume. One encoder serves all objects; the decoder is shared or each
object's own, and the last layer has weights of each object's own. Only those of the asked object
are computed.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor, nn

from .decoder import Decoder
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
        own_decoders: whether each object has a decoder of its own.
    """

    crop: int = 128
    stride: int = 4
    roi_scale: float = 1.4
    width: int = 64
    volume_channels: int = 32
    own_decoders: bool = False

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
        self.objects = objects
        self.decoders = nn.ModuleList(
            Decoder(self.encoder.channels, width, config.volume_channels)
            for _ in range(objects if config.own_decoders else 1)
        )
        self.embedding = nn.Embedding(objects, 64)
        self.film16 = nn.Linear(64, 2 * Decoder.WIDTH16)
        self.film4 = nn.Linear(64, 2 * width)
        for film in (self.film16, self.film4):
            nn.init.zeros_(film.weight)
            nn.init.zeros_(film.bias)
        outputs = 1 + 2 * KEYPOINTS
        self.head_weight = nn.Parameter(torch.randn(objects, outputs, width) * width**-0.5)
        self.head_bias = nn.Parameter(torch.zeros(objects, outputs))

    @property
    def volume_heads(self) -> nn.ModuleList:
        """The layers that make the map to lift, one for each decoder."""
        return nn.ModuleList(decoder.volume_head for decoder in self.decoders)  # type: ignore[misc]

    def split_decoders(self) -> None:
        """Gives each object a copy of the shared decoder; where each has its own, nothing."""
        if not self.config.own_decoders:
            shared = self.decoders[0]
            self.decoders = nn.ModuleList(copy.deepcopy(shared) for _ in range(self.objects))
            self.config = replace(self.config, own_decoders=True)

    def share_decoders(self) -> None:
        """Makes one decoder of all, the mean of them, which they once were copies of."""
        if self.config.own_decoders:
            shared = copy.deepcopy(self.decoders[0])
            states = [decoder.state_dict() for decoder in self.decoders]
            shared.load_state_dict(
                {n: torch.stack([s[n].double() for s in states]).mean(0) for n in states[0]}
            )
            self.decoders = nn.ModuleList([shared])
            self.config = replace(self.config, own_decoders=False)

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
        embedding = self.embedding(objects)
        x, volume = self._decode_each(
            pyramid[1:], self.film16(embedding), self.film4(embedding), objects
        )
        batch, width, height, breadth = x.shape
        maps = torch.baddbmm(
            self.head_bias[objects].to(x.dtype).unsqueeze(2),
            self.head_weight[objects].to(x.dtype),
            x.reshape(batch, width, height * breadth),
        ).reshape(batch, -1, height, breadth)
        return Features2D(
            mask_logits=maps[:, 0],
            directions=maps[:, 1:].reshape(batch, KEYPOINTS, 2, height, breadth),
            volume=volume,
            decoder=x,
        )

    def _decode_each(
        self, pyramid: Sequence[Tensor], film16: Tensor, film4: Tensor, objects: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Each crop through the decoder of its object; see :meth:`Decoder.forward`."""
        if not self.config.own_decoders:
            return self.decoders[0](pyramid, film16, film4)
        asked = objects.unique().tolist()
        if len(asked) == 1:
            return self.decoders[asked[0]](pyramid, film16, film4)
        parts, rows = [], []
        for number in asked:
            row = (objects == number).nonzero()[:, 0]
            maps = [level[row] for level in pyramid]
            parts.append(self.decoders[number](maps, film16[row], film4[row]))
            rows.append(row)
        back = torch.cat(rows).argsort()
        x, volume = (torch.cat(part)[back] for part in zip(*parts, strict=True))
        return x, volume
