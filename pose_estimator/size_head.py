"""How large the object appears in a crop, and so how far away it is.

The votes know the object's size only through small differences between keypoints, and their errors
are not independent: one view's depth from votes alone was off by 16 percent or more in a fifth of
the held-out crops, hidden and tilted ones among them. One number that is trained for itself knows
it better: 8 percent. CDPN (Li et al., ICCV 2019) and GDR-Net (Wang et al., CVPR 2021) estimate the
depth in the same way, relative to the crop.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

_SMALLEST_ERROR, _LARGEST_ERROR = -5.0, 0.0
"""Limits of the logarithm of the error that the head expects of itself; beyond them it would have
no gradient."""

_FIRST_ERROR = -2.0
"""The same before training."""


class SizeHead(nn.Module):
    """The object's size from the encoder's deep maps and the decoder's last one.

    Args:
        decoder: channels of the decoder's last map.
        deep: channels of the encoder's maps at strides 16 and 32.
        embedding: channels of the object's embedding.
        side: of the map at stride 32.
    """

    def __init__(self, decoder: int, deep: tuple[int, int], embedding: int, side: int):
        super().__init__()
        self.down = nn.Sequential(_halve(decoder + 1, 64), _halve(64, 96))
        self.merge16 = _block(96 + deep[0], 128, 1)
        self.merge32 = _block(128 + deep[1], 192, 2)
        last = nn.Linear(128, 2)
        with torch.no_grad():
            last.bias.copy_(torch.tensor([0.0, _FIRST_ERROR]))
        self.answer = nn.Sequential(
            nn.Linear(192 * side * side + embedding, 256),
            nn.ReLU(inplace=True),
            nn.Linear(256, 128),
            nn.ReLU(inplace=True),
            last,
        )

    def forward(
        self, decoder: Tensor, mask_logits: Tensor, f16: Tensor, f32: Tensor, embedding: Tensor
    ) -> Tensor:
        """Says how large the object appears.

        Args:
            decoder: (B, W, G, G).
            mask_logits: (B, G, G).
            f16: (B, C, G / 4, G / 4).
            f32: (B, C', G / 8, G / 8).
            embedding: (B, E) of the objects.

        Returns:
            (B, 2): the logarithm of the apparent size over that which the crop is made for, and the
            logarithm of the error to expect of it.
        """
        x = self.down(torch.cat([decoder, torch.sigmoid(mask_logits).unsqueeze(1)], 1))
        x = self.merge16(torch.cat([x, f16], 1))
        deep = F.interpolate(f32, scale_factor=2.0, mode="bilinear", align_corners=False)
        x = self.merge32(torch.cat([x, deep], 1))
        answer = self.answer(torch.cat([x.flatten(1), embedding.to(x.dtype)], 1)).float()
        return torch.stack([answer[:, 0], answer[:, 1].clamp(_SMALLEST_ERROR, _LARGEST_ERROR)], 1)


def size_losses(size: Tensor, true_size: Tensor) -> tuple[Tensor, Tensor]:
    """How far sizes are off, and how well they know it.

    Args:
        size: (B, 2) of :class:`SizeHead`.
        true_size: (B,) logarithms.

    Returns:
        The mean absolute error, and the negative log-likelihood of the errors under Laplace
        distributions of the widths that the head expects, which does not move the sizes.
    """
    miss = (size[:, 0] - true_size).abs()
    likelihood = miss.detach() * torch.exp(-size[:, 1]) + size[:, 1]
    return miss.mean(), likelihood.mean()


def _block(inputs: int, outputs: int, stride: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


def _halve(inputs: int, outputs: int) -> nn.Sequential:
    return _block(inputs, outputs, 2)
