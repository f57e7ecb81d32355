"""Reference networks: ResNet-18, whose cost is well known, and PVNet on top of it.

He et al., "Deep Residual Learning for Image Recognition", CVPR 2016; Peng et al., "PVNet:
Pixel-wise Voting Network for 6DoF Pose Estimation", CVPR 2019. Only their cost matters here, so
their weights are random.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F


def _conv(inputs: int, outputs: int, kernel: int = 3, stride: int = 1, dilation: int = 1) -> list:
    """A convolution that keeps the size but for its stride, and batch normalization."""
    padding = dilation * (kernel // 2)
    conv = nn.Conv2d(inputs, outputs, kernel, stride, padding, dilation, bias=False)
    return [conv, nn.BatchNorm2d(outputs)]


class BasicBlock(nn.Module):
    """Two 3x3 convolutions, dilated where a stride was taken out, and a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int, dilation: int = 1):
        super().__init__()
        self.body = nn.Sequential(
            *_conv(inputs, outputs, stride=stride, dilation=dilation),
            nn.ReLU(),
            *_conv(outputs, outputs, dilation=dilation),
        )
        same = stride == 1 and inputs == outputs
        self.shortcut = nn.Sequential(*([] if same else _conv(inputs, outputs, 1, stride)))

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(self.body(x) + self.shortcut(x))


def resnet18_stages(*last: tuple[int, int]) -> list[nn.Module]:
    """Stem, pooling and the four stages of ResNet-18, (stride, dilation) of the last two given."""
    stages: list[nn.Module] = [
        nn.Sequential(*_conv(3, 64, 7, 2), nn.ReLU()),
        nn.MaxPool2d(3, 2, 1),
    ]
    inputs = 64
    for width, (stride, dilation) in zip((64, 128, 256, 512), ((1, 1), (2, 1), *last), strict=True):
        first = BasicBlock(inputs, width, stride, dilation)
        stages.append(nn.Sequential(first, BasicBlock(width, width, 1, dilation)))
        inputs = width
    return stages


def resnet18() -> nn.Module:
    """ResNet-18 for (B, 3, H, W) images, with a 1000-way classifier."""
    head = [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(512, 1000)]
    return nn.Sequential(*resnet18_stages((2, 1), (2, 1)), *head)


class PVNet(nn.Module):
    """PVNet with ResNet-18: output stride 8, then a decoder up to full resolution.

    Args:
        keypoints: whose vectors it gives.
        classes: of its segmentation.
    """

    def __init__(self, keypoints: int = 9, classes: int = 2):
        super().__init__()
        self.backbone = nn.ModuleList(resnet18_stages((1, 2), (1, 4)))
        self.fc = nn.Sequential(*_conv(512, 256), nn.ReLU())
        self.decoder = nn.ModuleList(
            nn.Sequential(*_conv(inputs, outputs), nn.LeakyReLU(0.1))
            for inputs, outputs in ((256 + 128, 128), (128 + 64, 64), (64 + 64, 32), (32 + 3, 32))
        )
        self.head = nn.Conv2d(32, classes + 2 * keypoints, 1)

    def features(self, images: Tensor) -> list[Tensor]:
        """Maps (B, C, H / s, W / s) at strides 2, 4, 8 and, of the whole ResNet, 8."""
        stem, pool, layer1, layer2, layer3, layer4 = self.backbone
        at2 = stem(images)
        at4 = layer1(pool(at2))
        at8 = layer2(at4)
        return [at2, at4, at8, self.fc(layer4(layer3(at8)))]

    def forward(self, images: Tensor) -> Tensor:
        """Classes and vectors (B, classes + 2 keypoints, H, W) of images (B, 3, H, W)."""
        at2, at4, at8, x = self.features(images)
        for skip, layer in zip((at8, at4, at2, images), self.decoder, strict=True):
            x = layer(torch.cat([x, skip], 1))
            if skip is not images:
                x = F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)
        return self.head(x)
