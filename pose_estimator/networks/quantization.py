"""Symmetric int8 quantization of stored weights, with one scale per output channel.

Krishnamoorthi, "Quantizing deep convolutional networks for efficient inference: A whitepaper"
(2018), section 3. Only files are quantized: networks compute in full precision.
"""

import re
from collections.abc import Mapping, Set

import torch
from torch import Tensor, nn

from ...core.errors import InputError

_MAX_LEVEL = 127
_MIN_CHANNEL_SIZE = 32
"""Fewest numbers of a quantized output channel. Depthwise filters have fewer, and are small."""

_FIRST = re.compile(r"encoder\.stages\.[012]\.")
"""Layers that stay in half precision, as all others depend on them. They are half a percent of a
file, and reduce the change of votes by a third and of detections by half."""

_SCALE = ".scale"


def quantizable(networks: nn.Module) -> set[str]:
    """Names of the parameters to store in eight bits: weights of convolutions and linear layers."""
    return {
        f"{name}.weight"
        for name, module in networks.named_modules()
        if isinstance(module, nn.Conv2d | nn.Conv3d | nn.Linear)
        and module.weight[0].numel() >= _MIN_CHANNEL_SIZE
        and not _FIRST.search(name)
    }


def quantize(weight: Tensor) -> tuple[Tensor, Tensor]:
    """Rounds each output channel to 255 equal steps; the error is at most half a step.

    Scales are bfloat16: they have float32's range, and few enough digits that their multiples are
    exact. Quantizing again therefore changes nothing.

    Args:
        weight: (outputs, ...).

    Returns:
        int8 of the weight's shape, and the scales, bfloat16 (outputs,). A scale is NaN or infinite
        if the channel has such a number.
    """
    rows = weight.detach().float().flatten(1)
    scale = (rows.abs().amax(1) / _MAX_LEVEL).bfloat16()
    step = scale.float().masked_fill(scale == 0, 1.0)
    numbers = (rows / step[:, None]).nan_to_num().round().clamp(-_MAX_LEVEL, _MAX_LEVEL)
    return numbers.to(torch.int8).reshape(weight.shape).contiguous(), scale


def dequantize(numbers: Tensor, scale: Tensor) -> Tensor:
    """Inverse of :func:`quantize`, float32."""
    return (numbers.float().flatten(1) * scale.float()[:, None]).reshape(numbers.shape)


def pack(state: Mapping[str, Tensor], eight_bits: Set[str] = frozenset()) -> dict[str, Tensor]:
    """Converts tensors for a file: some to int8, others but batch statistics to float16.

    Args:
        state: tensors by name.
        eight_bits: names of those to quantize; their scales are added.

    Raises:
        InputError: if one holds NaN or numbers beyond half precision.
    """
    packed: dict[str, Tensor] = {}
    for name, value in state.items():
        if name in eight_bits:
            packed[name], packed[name + _SCALE] = quantize(value)
        elif value.is_floating_point() and "running" not in name:
            packed[name] = value.detach().half().contiguous()
        else:
            packed[name] = value.detach().contiguous()
    wrong = [n for n, t in packed.items() if t.is_floating_point() and not t.isfinite().all()]
    if wrong:
        raise InputError(
            "networks cannot be stored: NaN, or numbers too large for half precision, in "
            + ", ".join(name.removesuffix(_SCALE) for name in wrong[:3])
        )
    return packed


def unpack(packed: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors of :func:`pack` in float32.

    Raises:
        InputError: if scales are missing or not one for each output channel.
    """
    state = dict(packed)
    for name in [name for name, tensor in packed.items() if tensor.dtype == torch.int8]:
        scale = state.pop(name + _SCALE, None)
        if scale is None or scale.shape != state[name].shape[:1]:
            raise InputError(f"{name} lacks one scale for each of its output channels")
        state[name] = dequantize(state[name], scale)
    return {name: tensor.float() for name, tensor in state.items()}
