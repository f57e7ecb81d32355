"""Batch norm over the batch of all processes, for CPUs, which torch's SyncBatchNorm leaves out.

Ioffe & Szegedy, "Batch normalization", ICML 2015. With statistics of its own share alone, each
process would train another network than one process with the whole batch does.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional as F
from torch.nn.modules.batchnorm import _BatchNorm

from .data_parallel import world_size


class GlobalBatchNorm(_BatchNorm):
    """A batch norm whose statistics, in training, are those of all processes' samples.

    Every process must have as many samples as the others.
    """

    def _check_input_dim(self, input: Tensor) -> None:
        if input.ndim < 2:
            raise ValueError(f"expected (B, C, ...), got shape {tuple(input.shape)}")

    def forward(self, x: Tensor) -> Tensor:
        """Normalises (B, C, ...)."""
        if not self.training or world_size() == 1:
            return super().forward(x)
        self._check_input_dim(x)
        assert self.running_mean is not None and self.running_var is not None
        assert self.num_batches_tracked is not None and self.momentum is not None
        mean, variance = _statistics(x.detach())
        with torch.no_grad():
            count = world_size() * x.numel() // x.shape[1]
            self.num_batches_tracked.add_(1)
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * (count / (count - 1)), self.momentum)
        return _Normalise.apply(x, self.weight, self.bias, mean, variance, self.eps)


def synchronise_batch_norms(module: nn.Module) -> None:
    """Replaces batch norms within a module by ones over all processes' samples.

    Parameters, buffers and their names stay. With one process nothing is replaced.
    """
    if world_size() == 1:
        return
    for parent in list(module.modules()):
        for name, child in list(parent.named_children()):
            if isinstance(child, _BatchNorm) and not isinstance(child, GlobalBatchNorm):
                norm = GlobalBatchNorm(child.num_features, child.eps, child.momentum)
                norm.weight, norm.bias = child.weight, child.bias
                norm.running_mean, norm.running_var = child.running_mean, child.running_var
                norm.num_batches_tracked = child.num_batches_tracked
                norm.train(child.training)
                setattr(parent, name, norm)


def _statistics(x: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (C,) and biased variance (C,) over all processes' (B, C, ...), float32."""
    unused = torch.zeros(2, x.shape[1])
    own = torch.stack(torch.batch_norm_update_stats(x, unused[0], unused[1], 0.0)).float()
    every = [torch.empty_like(own) for _ in range(world_size())]
    dist.all_gather(every, own)
    means, variances = torch.stack(every).unbind(1)
    mean = means.mean(0)
    # Chan et al. 1979: squares about the own means, and of these about the common one.
    return mean, variances.mean(0) + (means - mean).square().mean(0)


class _Normalise(torch.autograd.Function):
    """Normalises by statistics that depend on all processes' samples, also in the gradient."""

    @staticmethod
    def forward(
        ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, mean: Tensor, variance: Tensor,
        epsilon: float,
    ) -> Tensor:  # fmt: skip
        ctx.save_for_backward(x, weight, mean, variance)
        ctx.epsilon = epsilon
        return F.batch_norm(x, mean, variance, weight, bias, False, 0.0, epsilon)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        x, weight, mean, variance = ctx.saved_tensors
        # As if the statistics were constants; then what flows through them.
        to_x, to_weight, to_bias = torch.ops.aten.native_batch_norm_backward(
            gradients[0], x, weight, mean, variance, None, None, False, ctx.epsilon, [True] * 3
        )
        sums = torch.stack([to_weight, to_bias]).float()
        dist.all_reduce(sums)
        count = world_size() * x.numel() // x.shape[1]
        inverse = (variance + ctx.epsilon).rsqrt()
        slope = weight * inverse * sums[0] / count * inverse
        level = weight * inverse * sums[1] / count - slope * mean
        shape = (1, -1) + (1,) * (x.ndim - 2)
        to_x -= x * slope.view(shape) + level.view(shape)
        return to_x, to_weight, to_bias, None, None, None
