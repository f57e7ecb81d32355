"""Makes the CPU as strict as a GPU: tensors without their device, or read in place, raise."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves


class OnHost(Tensor):
    """What ``torch.from_numpy`` makes: it may be reshaped and moved, and nothing else."""

    @classmethod
    def __torch_function__(
        cls, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        name = func.__name__
        with torch._C.DisableTorchFunctionSubclass():
            result = func(*args, **(kwargs or {}))
        if name in ("to", "__get__"):
            return result.as_subclass(Tensor) if isinstance(result, Tensor) else result
        if name in ("float", "double", "reshape"):
            return result.as_subclass(OnHost)
        raise RuntimeError(f"{name} of an array's tensor, which was not moved to the device")


class NoMetaTensors(TorchFunctionMode):
    """Raises where a tensor on "meta" is created; not every operation on one does."""

    def __torch_function__(
        self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        result = func(*args, **(kwargs or {}))
        if any(isinstance(part, Tensor) and part.is_meta for part in tree_leaves(result)):
            raise RuntimeError(f"{func.__name__} made a tensor without its device")
        return result


@contextlib.contextmanager
def strict_host() -> Iterator[None]:
    """Lets ordinary tensors stand for those on a device.

    A tensor created without its device is on "meta", one created from an array must be moved
    first, and ``numpy()`` requires ``cpu()`` right before it.
    """
    numpy, cpu, from_numpy = Tensor.numpy, Tensor.cpu, torch.from_numpy

    def fetch(self: Tensor) -> Tensor:
        fetched = cpu(self).clone()
        fetched.was_fetched = True  # type: ignore[attr-defined]
        return fetched

    def read(self: Tensor) -> np.ndarray:
        if not hasattr(self, "was_fetched"):
            raise RuntimeError("numpy() of a tensor that cpu() did not fetch")
        return numpy(self)

    _forget()
    with pytest.MonkeyPatch.context() as patch, torch.device("meta"), NoMetaTensors():
        patch.setattr(Tensor, "cpu", fetch)
        patch.setattr(Tensor, "numpy", read)
        patch.setattr(torch, "from_numpy", lambda array: from_numpy(array).as_subclass(OnHost))
        try:
            yield
        finally:
            _forget()


def _forget() -> None:
    """Empties the package's caches, so that cached tensors are created again."""
    for name, module in list(sys.modules.items()):
        if name.startswith("two_view_pose.pose_estimator"):
            for value in list(vars(module).values()):
                getattr(value, "cache_clear", lambda: None)()
