"""2D features of a crop, shared by all fusion strategies.

For the requested object a multi-scale CNN gives its mask, unit vectors from each pixel to its nine
keypoints (Peng et al., "PVNet", CVPR 2019), and the feature map that Mid-Fusion lifts into its
volume. The encoder is shared; the decoder is shared or one for each object; the last layer has
weights for each object, of which only the requested ones are computed.
"""

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
        own_decoders: whether each object has its own decoder.
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
        directions: (B, 9, 2, G, G), vectors (x, y) to each keypoint. They are trained to unit
            length, and are shorter where the confidence is low.
        volume: (B, C, G, G), features for the volume.
        decoder: (B, W, G, G), the decoder's last map, from which the others are projected.
    """

    mask_logits: Tensor
    directions: Tensor
    volume: Tensor
    decoder: Tensor


class KeypointNet(nn.Module):
    """The 2D network of ``objects`` objects."""

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
        """The decoders' layers that compute the map to lift."""
        return nn.ModuleList(decoder.volume_head for decoder in self.decoders)  # type: ignore[misc]

    def split_decoders(self) -> None:
        """Gives each object a copy of the shared decoder, unless each has its own."""
        if not self.config.own_decoders:
            shared = self.decoders[0]
            self.decoders = nn.ModuleList(copy.deepcopy(shared) for _ in range(self.objects))
            self.config = replace(self.config, own_decoders=True)

    def share_decoders(self) -> None:
        """Replaces the objects' decoders by their mean."""
        if self.config.own_decoders:
            shared = copy.deepcopy(self.decoders[0])
            states = [decoder.state_dict() for decoder in self.decoders]
            shared.load_state_dict(
                {n: torch.stack([s[n].double() for s in states]).mean(0) for n in states[0]}
            )
            self.decoders = nn.ModuleList([shared])
            self.config = replace(self.config, own_decoders=False)

    def forward(self, crops: Tensor, objects: Tensor) -> Features2D:
        """Computes maps of side S / 4.

        Args:
            crops: (B, 3, S, S), RGB in 0..255 as floats.
            objects: (B,) int64, the index of the requested object of each crop.
        """
        return self.decode(self.encoder.pyramid(crops), objects)

    def decode(self, pyramid: Sequence[Tensor], objects: Tensor) -> Features2D:
        """As :meth:`forward`, from the encoder's maps at strides 2 to 32."""
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
        """Decodes each crop by its object's decoder; see :meth:`Decoder.forward`."""
        if not self.config.own_decoders:
            return self.decoders[0](pyramid, film16, film4)
        requested = objects.unique().tolist()
        if len(requested) == 1:
            return self.decoders[requested[0]](pyramid, film16, film4)
        parts, rows = [], []
        for number in requested:
            row = (objects == number).nonzero()[:, 0]
            maps = [level[row] for level in pyramid]
            parts.append(self.decoders[number](maps, film16[row], film4[row]))
            rows.append(row)
        back = torch.cat(rows).argsort()
        x, volume = (torch.cat(part)[back] for part in zip(*parts, strict=True))
        return x, volume
