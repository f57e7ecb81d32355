"""Runs the networks on lists of inputs.

On a CPU every item of a list (a frame, a few crops of a view, a volume) is a batch of its own that
one thread runs on one core (``core/thread_pools.py``); a single item may use more cores if the
result is identical. Other batch sizes and thread counts round differently: this way a result does
not depend on the other items or on the load. On a GPU a list is one batch, and results depend on it
up to rounding.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, is_dataclass
from itertools import islice
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils._pytree import tree_leaves

from ...core.cpu_cores import available_cores, idle_cores
from ...core.device import uses_bfloat16
from ...core.thread_pools import shared_pool
from .container import PoseNetworks
from .fused import fused
from .volume import ViewMaps
from .voting import vote

_CROPS = 3
"""Crops of a view per batch on a core: fewer are slower per crop, more leave cores idle."""

_GPU_ITEMS = 64
"""Items of a batch on a GPU: fills it, and bounds its memory."""

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True, eq=False)
class EncodedCrop:
    """Features and votes of a crop for an object.

    Attributes:
        volume: features for the volume, (C, G, G).
        decoder: the 2D network's last map, (W, G, G).
        maps: the encoder's maps at strides 2 to 32, (C, S, S) each.
        vote_mean: voted keypoints, (9, 2), pixels of the feature grid.
        vote_covariance: (9, 2, 2).
        vote_score: share of the object's pixels that are inliers, 0 to 1, (9,).
        mask: probability of the visible object, (G, G).
    """

    volume: Tensor
    decoder: Tensor
    maps: tuple[Tensor, ...]
    vote_mean: np.ndarray
    vote_covariance: np.ndarray
    vote_score: np.ndarray
    mask: np.ndarray


class Inference:
    """Runs one set of networks.

    Args:
        networks: in evaluation mode, on their device. Weights are read at the first run.
        threads: of the CPU; 0: one for each core. Not used on a GPU.
    """

    def __init__(self, networks: PoseNetworks, threads: int = 0) -> None:
        self.networks = networks
        self.device = networks.device
        self.bfloat16 = uses_bfloat16(self.device)
        self.threads = threads or available_cores()
        self._fused_modules: dict[str, tuple[nn.Module, nn.Module]] = {}
        self._same_on: dict[tuple[Hashable, int], bool] = {}

    def detect(self, frames: Sequence[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Runs the detector on its inputs, (240, 320, 3) uint8 each.

        Returns:
            For each frame the heat map (N, 30, 40) and regression (N, 3, 30, 40) of all objects,
            float32; see ``Detector.forward``.
        """
        network = self.network("detector")

        def detect(frames: Sequence[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
            logits, regression = (
                part.float().cpu().numpy() for part in network(self._images(frames))
            )
            return list(zip(logits, regression, strict=True))

        return self.in_batches(detect, frames, kind="frame")

    def encode(self, crops: Sequence[tuple[np.ndarray, int]]) -> list[list[EncodedCrop]]:
        """Computes features and votes of views' crops (n, S, S, 3) uint8 for an object's index.

        Maps stay on the device.
        """
        network = self.network("features")
        parts = [
            (own[start : start + _CROPS], index)
            for own, index in crops
            for start in range(0, len(own), _CROPS)
        ]

        def encode(crops: Sequence[tuple[np.ndarray, int]]) -> list[list[EncodedCrop]]:
            pyramid = network.encoder.pyramid(self._images([c for own, _ in crops for c in own]))
            objects = [index for own, index in crops for _ in own]
            features = network.decode(pyramid, torch.tensor(objects, device=self.device))
            volume = features.volume.float()
            mean, covariance, score = (as_array(part) for part in vote(features))
            mask = torch.sigmoid(features.mask_logits.float()).cpu().numpy()
            levels = zip(*pyramid, strict=True)
            found = map(
                EncodedCrop, volume, features.decoder, levels, mean, covariance, score, mask
            )
            return [list(islice(found, len(own))) for own, _ in crops]

        kind = ("crops", len(parts[0][0])) if len(parts) == 1 else None
        encoded = (crop for part in self.in_batches(encode, parts, kind=kind) for crop in part)
        return [list(islice(encoded, len(own))) for own, _ in crops]

    def fuse(
        self, volumes: Sequence[tuple[ViewMaps, np.ndarray, float]]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Computes keypoints of volumes.

        Args:
            volumes: for each the views' maps (a batch of one), the initial object center in the
                reference camera, (3,) m, and the diameter, m.

        Returns:
            For each the fine level's keypoints (9, 3) in the reference camera, m, and their
            covariances (9, 3, 3), m^2.
        """
        network = self.network("volume")

        def fuse(
            volumes: Sequence[tuple[ViewMaps, np.ndarray, float]],
        ) -> list[tuple[np.ndarray, np.ndarray]]:
            maps, guesses, diameters = zip(*volumes, strict=True)
            fine = network(
                ViewMaps(*(torch.cat(part) for part in zip(*maps, strict=True))),
                self.tensor(np.stack(guesses)),
                self.tensor(np.array(diameters)),
            )[-1]
            return list(zip(as_array(fine.keypoints), as_array(fine.covariance), strict=True))

        config = self.networks.volume.config
        # Where the voxel size is fixed, the number of voxels depends on the diameter.
        same_shape = None not in (config.coarse.cells, config.fine.cells)
        return self.in_batches(
            fuse,
            volumes,
            lambda volume: (volume[0].features.shape[1], 0 if same_shape else volume[2]),
        )

    def in_batches(
        self,
        work: Callable[[Sequence[_Item]], list[_Result]],
        items: Sequence[_Item],
        key: Callable[[_Item], Any] = lambda item: 0,
        kind: Hashable = None,
    ) -> list[_Result]:
        """Runs networks on a list under autocast: item by item on a CPU, in batches on a GPU.

        Args:
            work: processes a batch.
            items: the list.
            key: equal for items of one batch.
            kind: network and input shape of a single item that several cores may share; None: it
                may not be shared.

        Returns:
            The results in the list's order.
        """

        @torch.inference_mode()
        def run(batch: Sequence[_Item]) -> list[_Result]:
            with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bfloat16):
                return work(batch)

        if self.device.type == "cpu":

            def run_one(item: _Item) -> _Result:
                return run([item])[0]

            if len(items) == 1 and kind is not None:
                return [self._on_idle_cores(run_one, items[0], kind)]
            return list(shared_pool(self.threads).map(run_one, items))
        groups: dict[Any, list[int]] = {}
        for number, item in enumerate(items):
            groups.setdefault(key(item), []).append(number)
        results: dict[int, _Result] = {}
        for numbers in groups.values():
            for start in range(0, len(numbers), _GPU_ITEMS):
                some = numbers[start : start + _GPU_ITEMS]
                results |= zip(some, run([items[n] for n in some]), strict=True)
        return [results[n] for n in range(len(items))]

    def _on_idle_cores(
        self, run: Callable[[_Item], _Result], item: _Item, kind: Hashable
    ) -> _Result:
        """Runs one item on all of this thread's cores if the result is identical to one core's.

        The first item of a kind is run both ways to find out.
        """
        cores = torch.get_num_threads()
        pool = shared_pool(self.threads)
        if not 1 < cores <= min(self.threads, idle_cores()):
            return pool.submit(run, item).result()
        if (kind, cores) not in self._same_on:
            on_one = pool.submit(run, item).result()
            self._same_on[kind, cores] = _identical(on_one, run(item))
            return on_one
        return run(item) if self._same_on[kind, cores] else pool.submit(run, item).result()

    def tensor(self, array: np.ndarray) -> Tensor:
        """An array as float32 on the networks' device."""
        return torch.from_numpy(array).to(self.device, torch.float32)

    def network(self, part: str) -> Any:
        """The fastest form of a network; built at first use."""
        module = getattr(self.networks, part)
        if self.device.type != "cpu":
            return module
        known = self._fused_modules.get(part)
        if known is None or known[0] is not module:
            quick = fused(module, torch.bfloat16 if self.bfloat16 else torch.float32)
            known = self._fused_modules[part] = module, quick
        return known[1]

    def _images(self, images: Sequence[np.ndarray]) -> Tensor:
        """Images (H, W, 3) uint8 as a batch (B, 3, H, W) float32, channels last."""
        batch = torch.from_numpy(np.stack(images)).to(self.device).permute(0, 3, 1, 2)
        return batch.float().contiguous(memory_format=torch.channels_last)


def _identical(one: Any, other: Any) -> bool:
    """Whether two results are equal bit for bit."""

    def arrays(result: Any) -> Iterator[Any]:
        for leaf in tree_leaves(result):
            if is_dataclass(leaf):
                yield from arrays(vars(leaf))
            else:
                yield leaf

    pairs = zip(arrays(one), arrays(other), strict=True)
    # NumPy has no bfloat16.
    return all(torch.equal(torch.as_tensor(a), torch.as_tensor(b)) for a, b in pairs)


def as_array(tensor: Tensor) -> np.ndarray:
    """A tensor as a float64 array."""
    return tensor.double().cpu().numpy()
