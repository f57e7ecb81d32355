"""Initializes networks from weights of other objects or another preset: the compatible parts.

Most of each network is shared by all objects. The rows of a few tensors that belong to one object
are copied for the objects that both know; for the others they start untrained.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ..methods import PARTS
from ..networks.container import PoseNetworks
from ..networks.detector import DetectorConfig
from ..networks.features import FeatureConfig

_ROWS = ("embedding.weight", "head_weight", "head_bias")
"""Suffixes of the names of tensors with one row per object."""

_OWN_DECODER = re.compile(r"features\.decoders\.(\d+)\.(.+)")

_DETECTOR_HEAD = ("detector.head.weight", "detector.head.bias")
"""Tensors with one row per object, followed by three (offset and size) per object."""


@dataclass(frozen=True)
class Transfer:
    """What was loaded.

    Attributes:
        known: objects that both know, in the order of the networks.
        new: the other objects of the networks.
        parts: the parts that were loaded, completely or without the rows of new objects.
        incomplete: those of ``parts`` that lack rows of new objects.
        adapted: the volume, if it is of another preset: a start for its training.
    """

    known: tuple[str, ...]
    new: tuple[str, ...]
    parts: tuple[str, ...]
    incomplete: tuple[str, ...]
    adapted: tuple[str, ...]

    def __str__(self) -> str:
        lines = [f"loaded: {', '.join(self.parts) or 'nothing'}"]
        if self.new and self.incomplete:
            lines.append(
                f"new: {', '.join(self.new)} in {', '.join(self.incomplete)}; "
                f"known before: {', '.join(self.known) or 'none of the objects'}"
            )
        if self.adapted:
            lines.append(f"of another preset, to be trained: {', '.join(self.adapted)}")
        return "\n".join(lines)


def transfer_weights(source: PoseNetworks, networks: PoseNetworks) -> Transfer:
    """Copies the compatible weights of ``source`` into ``networks`` and sets their ``trained``.

    The layers of a volume of another preset are copied as far as they see the same input, as voxels
    of all presets are about as large. Such a volume, and a part that lacks rows of new objects, do
    not count as trained.

    Raises:
        InputError: if the networks have other shapes.
    """
    for part in ("detector", "features"):
        wanted, given = (_shape(getattr(n.config, part)) for n in (networks, source))
        if given != wanted:
            raise InputError(f"the weights are of networks of another shape: {given}, not {wanted}")
    own_decoders = source.config.features.own_decoders
    if own_decoders:
        networks.features.split_decoders()
    else:
        networks.features.share_decoders()
    known = tuple(n for n in networks.objects if _same_model(networks.objects, source.objects, n))
    new = tuple(name for name in networks.objects if name not in known)
    rows = {networks.index[name]: source.index[name] for name in known}
    other_volume = source.config.preset != networks.config.preset
    adapted = tuple(p for p in PARTS if p in source.trained and p == "volume" and other_volume)
    parts = tuple(p for p in PARTS if p in source.trained and p not in adapted)
    if adapted:
        _adapt_volume(source, networks)
    theirs, incomplete = source.state_dict(), set()
    for name, value in networks.state_dict().items():
        part = name.split(".")[0]
        if part not in parts:
            continue
        axes = _object_rows(name, len(networks.objects))
        if axes is not None and new:
            incomplete.add(part)
        decoder = _OWN_DECODER.match(name)
        if decoder is not None and own_decoders:
            # A new object's decoder starts as the mean of the source's decoders.
            number = int(decoder[1])
            others = [rows[number]] if number in rows else range(len(source.objects))
            copies = [theirs[f"features.decoders.{other}.{decoder[2]}"] for other in others]
            value.copy_(torch.stack(copies).double().mean(0))
        elif name not in theirs or (axes is None and theirs[name].shape != value.shape):
            raise InputError(f"the weights are of networks of another shape: {name} does not fit")
        elif axes is None:
            value.copy_(theirs[name])
        else:
            their_axes = _object_rows(name, len(source.objects))
            assert their_axes is not None
            for mine, other in rows.items():
                value[axes[mine]] = theirs[name][their_axes[other]]
    networks.trained = frozenset(parts) - incomplete
    return Transfer(known, new, parts, tuple(p for p in parts if p in incomplete), adapted)


def _adapt_volume(source: PoseNetworks, networks: PoseNetworks) -> None:
    """Copies a volume of another preset; of the first layers what reads the views' features."""
    features = 2 * networks.config.features.volume_channels
    theirs = source.volume.state_dict()
    for name, value in networks.volume.state_dict().items():
        if value.shape == theirs[name].shape:
            value.copy_(theirs[name])
        else:
            value.zero_()
            value[:, :features] = theirs[name][:, :features]


def _shape(config: DetectorConfig | FeatureConfig) -> DetectorConfig | FeatureConfig:
    """The configuration apart from the number of its decoders."""
    return replace(config, own_decoders=False) if isinstance(config, FeatureConfig) else config


def _same_model(
    objects: Mapping[str, ObjectModel], others: Mapping[str, ObjectModel], name: str
) -> bool:
    """Whether both have an object of this name with the same keypoints."""
    return (
        name in objects
        and name in others
        and np.allclose(objects[name].keypoints, others[name].keypoints, atol=1e-6)
    )


def _object_rows(name: str, count: int) -> Sequence[Tensor] | None:
    """The rows of a tensor that belong to each of ``count`` objects; None if it is shared."""
    if name.endswith(_ROWS):
        return [torch.tensor([index]) for index in range(count)]
    if name in _DETECTOR_HEAD:
        return [
            torch.tensor([index, *range(count + 3 * index, count + 3 * index + 3)])
            for index in range(count)
        ]
    return None
