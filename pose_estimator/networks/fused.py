"""Fuses convolutions with batch norm and activation for inference on CPUs.

Batch norm in evaluation mode is folded into the weights. oneDNN adds the bias and applies the
activation while the result is still in the cache; as separate layers, clipping and padding cost
more than the convolutions of a MobileNet. Weights are rounded to bfloat16 once, where the CPU
supports it, and reordered once to oneDNN's layout.
"""

from copy import copy
from functools import cache
from typing import TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .encoder import SameConv

_MAX_PREPACKED_BATCH = 4
"""Largest batch of images for which reordered weights are cached: larger ones gain less, and have
many sizes. Volumes have few weights."""

_Conv = nn.Conv2d | nn.Conv3d
_Norm = nn.BatchNorm2d | nn.BatchNorm3d
M = TypeVar("M", bound=nn.Module)


def can_fuse() -> bool:
    """Whether this build of torch has the two private operators used here."""
    return torch.backends.mkldnn.is_available() and all(
        hasattr(torch.ops.mkldnn, operator)
        for operator in ("_convolution_pointwise", "_reorder_convolution_weight")
    )


@cache
def can_fuse_in(dtype: torch.dtype) -> bool:
    """Whether fused convolutions run in a dtype on this processor; tries one.

    For bfloat16 it depends on ``ONEDNN_MAX_CPU_ISA`` and the versions of torch and oneDNN as well.
    """
    if not can_fuse():
        return False
    try:
        # Without initialization, which would change the state of the random generator.
        conv = nn.utils.skip_init(nn.Conv2d, 8, 8, 3)
        with torch.inference_mode():
            FusedConv(conv, dtype)(torch.zeros(1, 8, 8, 8))
    except RuntimeError:
        return False
    return True


def fused(module: M, dtype: torch.dtype) -> M:
    """A copy of a network in evaluation mode with fused convolutions; without oneDNN, the network.

    The copy has its own convolution weights and shares the other parameters. It cannot be trained.
    ``dtype`` is the convolutions', bfloat16 or float32; :func:`can_fuse_in` must hold.
    """
    if not can_fuse():
        return module
    return _fused(module, dtype)  # type: ignore[return-value]


class FusedConv(nn.Module):
    """A convolution with bias and an optional activation.

    Args:
        conv: the convolution.
        dtype: to compute in.
        norm: batch norm after it, in evaluation mode.
        relu: whether a ReLU comes last.
    """

    weight: Tensor

    def __init__(
        self, conv: _Conv, dtype: torch.dtype, norm: _Norm | None = None, relu: bool = False
    ) -> None:
        super().__init__()
        weight = conv.weight.detach()
        bias = None if conv.bias is None else conv.bias.detach()
        if norm is not None:
            weight, bias = _fold(weight, bias, norm)
        self.padding = [int(p) for p in conv.padding]  # type: ignore[arg-type]
        if isinstance(conv, SameConv) and conv.stride[0] > 1:
            # A zero row and column of the kernel replace asymmetric padding.
            weight = F.pad(weight, (1, 0, 1, 0))
            self.padding = [weight.shape[-1] // 2 - 1] * 2
        self.stride, self.dilation = list(conv.stride), list(conv.dilation)
        self.groups = conv.groups
        layout = torch.channels_last if weight.ndim == 4 else torch.channels_last_3d
        self.register_buffer("weight", weight.to(dtype).contiguous(memory_format=layout))
        self.register_buffer("bias", None if bias is None else bias.to(dtype))
        self._prepacked_weights: dict[tuple[int, ...], Tensor] = {}
        self.activation = "relu" if relu else "none"

    def forward(self, x: Tensor) -> Tensor:
        return self._apply_conv(x, self.activation, [])

    def relu6(self, x: Tensor) -> Tensor:
        """The convolution, its result clipped to 0..6."""
        return self._apply_conv(x, "hardtanh", [0.0, 6.0])

    def _apply_conv(self, x: Tensor, activation: str, limits: list[float]) -> Tensor:
        return torch.ops.mkldnn._convolution_pointwise(
            x.to(self.weight.dtype), self._weight_for(x.shape), self.bias, self.padding,
            self.stride, self.dilation, self.groups, activation, limits, "",
        )  # fmt: skip

    def _weight_for(self, shape: torch.Size) -> Tensor:
        """The weight in oneDNN's layout, which depends on the input's shape and the threads.

        With another layout it is many times slower, and otherwise reorders at every call.
        """
        if len(shape) == 4 and shape[0] > _MAX_PREPACKED_BATCH:
            return self.weight
        key = torch.get_num_threads(), *shape
        weight = self._prepacked_weights.get(key)
        if weight is None:
            with torch.inference_mode(False):
                weight = self._prepacked_weights[key] = (
                    torch.ops.mkldnn._reorder_convolution_weight(
                        self.weight,
                        self.padding,
                        self.stride,
                        self.dilation,
                        self.groups,
                        list(shape),
                    )
                )
        return weight


def _fused(module: nn.Module, dtype: torch.dtype) -> nn.Module:
    if isinstance(module, _Conv):
        return FusedConv(module, dtype)
    twin = copy(module)
    if isinstance(module, nn.Sequential):
        layers = _fuse_conv_bn_relu(list(module), dtype)
        twin._modules = {str(number): layer for number, layer in enumerate(layers)}
    else:
        twin._modules = {
            name: child if child is None else _fused(child, dtype)
            for name, child in module._modules.items()
        }
    return twin


def _fuse_conv_bn_relu(layers: list[nn.Module], dtype: torch.dtype) -> list[nn.Module]:
    """Fuses each convolution with the batch norm and ReLU after it."""
    merged: list[nn.Module] = []
    while layers:
        first, *layers = layers
        if isinstance(first, _Conv):
            norm = layers.pop(0) if layers and isinstance(layers[0], _Norm) else None
            relu = bool(layers) and isinstance(layers[0], nn.ReLU)
            merged.append(FusedConv(first, dtype, norm, relu))  # type: ignore[arg-type]
            layers = layers[relu:]
        else:
            merged.append(_fused(first, dtype))
    return merged


def _fold(weight: Tensor, bias: Tensor | None, norm: _Norm) -> tuple[Tensor, Tensor]:
    """Weight and bias of a convolution with the batch norm after it folded in."""
    assert norm.running_mean is not None and norm.running_var is not None
    scale = norm.weight.detach() / torch.sqrt(norm.running_var + norm.eps)
    mean = norm.running_mean if bias is None else norm.running_mean - bias
    shaped = scale.reshape(-1, *[1] * (weight.ndim - 1))
    return weight * shaped, norm.bias.detach() - mean * scale
