"""The yardsticks of the benchmark: ResNet-18, whose cost everybody knows, and PVNet on top of it.

He et al., "Deep Residual Learning for Image Recognition", CVPR 2016; Peng et al., "PVNet:
Pixel-wise Voting Network for 6DoF Pose Estimation", CVPR 2019. Only their cost matters here, so
their weights are random.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class BasicBlock(nn.Module):
    """Two 3x3 convolutions, dilated where a stride was taken out, and a shortcut."""

    def __init__(self, inputs: int, outputs: int, stride: int, dilation: int = 1):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, dilation, dilation, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.shortcut: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.shortcut = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu(self.bn1(self.conv1(x)))
        return F.relu(self.bn2(self.conv2(y)) + self.shortcut(x))


def resnet18() -> nn.Module:
    """ResNet-18 for (B, 3, H, W) pictures, with a 1000-way classifier."""
    torch.manual_seed(0)
    layers: list[nn.Module] = [
        nn.Conv2d(3, 64, 7, 2, 3, bias=False),
        nn.BatchNorm2d(64),
        nn.ReLU(),
        nn.MaxPool2d(3, 2, 1),
    ]
    channels = 64
    for width, stride in ((64, 1), (128, 2), (256, 2), (512, 2)):
        layers += [BasicBlock(channels, width, stride), BasicBlock(width, width, 1)]
        channels = width
    layers += [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(512, 1000)]
    return nn.Sequential(*layers)


class PVNet(nn.Module):
    """PVNet with ResNet-18: output stride 8, then a decoder up to full resolution.

    Args:
        keypoints: whose vectors it gives.
        classes: of its segmentation.
    """

    def __init__(self, keypoints: int = 9, classes: int = 2):
        super().__init__()
        torch.manual_seed(0)
        self.stem = _conv(3, 64, nn.ReLU(), kernel=7, stride=2)
        self.pool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = _stage(64, 64, 1)
        self.layer2 = _stage(64, 128, 2)
        self.layer3 = _stage(128, 256, 1, dilation=2)
        self.layer4 = _stage(256, 512, 1, dilation=4)
        self.fc = _conv(512, 256, nn.ReLU())
        leaky = nn.LeakyReLU(0.1)
        self.conv8 = _conv(256 + 128, 128, leaky)
        self.conv4 = _conv(128 + 64, 64, leaky)
        self.conv2 = _conv(64 + 64, 32, leaky)
        self.conv1 = nn.Sequential(
            _conv(32 + 3, 32, leaky), nn.Conv2d(32, classes + 2 * keypoints, 1)
        )

    def features(self, pictures: Tensor) -> list[Tensor]:
        """Maps (B, C, H / s, W / s) at strides 2, 4, 8 and, of the whole ResNet, 8."""
        at2 = self.stem(pictures)
        at4 = self.layer1(self.pool(at2))
        at8 = self.layer2(at4)
        return [at2, at4, at8, self.fc(self.layer4(self.layer3(at8)))]

    def forward(self, pictures: Tensor) -> Tensor:
        """Classes and vectors (B, classes + 2 keypoints, H, W) of pictures (B, 3, H, W)."""
        at2, at4, at8, deep = self.features(pictures)
        x = _double(self.conv8(torch.cat([deep, at8], 1)))
        x = _double(self.conv4(torch.cat([x, at4], 1)))
        x = _double(self.conv2(torch.cat([x, at2], 1)))
        return self.conv1(torch.cat([x, pictures], 1))


def _conv(
    inputs: int, outputs: int, activation: nn.Module, kernel: int = 3, stride: int = 1
) -> nn.Module:
    conv = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
    return nn.Sequential(conv, nn.BatchNorm2d(outputs), activation)


def _stage(inputs: int, outputs: int, stride: int, dilation: int = 1) -> nn.Module:
    return nn.Sequential(
        BasicBlock(inputs, outputs, stride, dilation), BasicBlock(outputs, outputs, 1, dilation)
    )


def _double(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)
