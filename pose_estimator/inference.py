"""The networks as estimators run them: questions in, answers out, several questions at once.

An estimate is arithmetic between a few questions to the networks. Whoever puts them may be one
estimate, which asks one question at a time, or many side by side (:mod:`lockstep`), whose questions
of one kind are answered as one batch. An answer does not depend on what else is in its batch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from .device import uses_bfloat16
from .features import Features2D
from .fused import fused
from .networks import PoseNetworks
from .volume import LevelOutput, ViewMaps
from .voting import vote

_CROPS_AT_ONCE = 12
"""Crops from which on a batch gets no quicker for each."""

Question = Any
"""A :class:`Detect`, :class:`Encode`, :class:`Fuse` or :class:`Run`."""

Ask = Callable[[Question], Any]
"""Puts a question and waits for its answer."""


@dataclass(frozen=True, eq=False)
class Detect:
    """Where might objects be in a picture? Answered by heat map and regression of all objects,
    (N, 30, 40) and (N, 3, 30, 40) float32 (see ``Detector.forward``).

    Attributes:
        picture: the detector's input, (240, 320, 3) uint8.
    """

    picture: np.ndarray


@dataclass(frozen=True, eq=False)
class Encode:
    """What do crops show of an object? Answered by :class:`EncodedCrops`.

    Attributes:
        crops: (n, S, S, 3) uint8.
        index: which object, in the networks' order.
    """

    crops: np.ndarray
    index: int


@dataclass(frozen=True, eq=False)
class Fuse:
    """Where are the keypoints in a volume? Answered by its fine level, a batch of one.

    Attributes:
        views: what the views bring, a batch of one.
        guess: the object's centre in the reference camera, (3,) metres.
        diameter: of the object, metres.
    """

    views: ViewMaps
    guess: np.ndarray
    diameter: float


@dataclass(frozen=True, eq=False)
class Run:
    """Anything else that needs the networks; answered by what it returns.

    Attributes:
        work: is called under inference mode.
    """

    work: Callable[[], Any]


class EncodedCrops(NamedTuple):
    """What n crops show.

    Attributes:
        features: the 2D network's output, n crops.
        pyramid: the encoder's maps at strides 2 to 32, (n, C, s, s) each.
        mean: voted keypoints, (n, 9, 2), pixels of the feature grid.
        covariance: theirs, (n, 9, 2, 2).
        score: share of the object's pixels that agree, (n, 9).
    """

    features: Features2D
    pyramid: tuple[Tensor, ...]
    mean: np.ndarray
    covariance: np.ndarray
    score: np.ndarray


class Inference:
    """Answers questions with one set of networks.

    Args:
        networks: in evaluation mode. Their weights are read when they are first asked.
    """

    def __init__(self, networks: PoseNetworks) -> None:
        self.networks = networks
        self.device = networks.device
        self.bfloat16 = uses_bfloat16(self.device)
        self._quick: dict[str, tuple[nn.Module, nn.Module]] = {}

    def ask(self, question: Question) -> Any:
        """Answers one question."""
        return self.answer([question])[0]

    @torch.inference_mode()
    def answer(self, questions: Sequence[Question]) -> list[Any]:
        """Answers several questions, those of one kind together."""
        answers: list[Any] = [None] * len(questions)
        kinds: dict[Any, list[int]] = {}
        for number, question in enumerate(questions):
            kinds.setdefault(self._kind(question, number), []).append(number)
        for (kind, *_), numbers in kinds.items():
            found = self._together(kind, [questions[n] for n in numbers])
            for number, answer in zip(numbers, found, strict=True):
                answers[number] = answer
        return answers

    def autocast(self) -> torch.autocast:
        """bfloat16 where the device is fast at it."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.bfloat16)

    def _network(self, part: str) -> Any:
        """A part of the networks as it runs quickest; made when it is first needed."""
        module = getattr(self.networks, part)
        known = self._quick.get(part)
        if known is None or known[0] is not module:
            quick = fused(module, torch.bfloat16 if self.bfloat16 else torch.float32)
            known = self._quick[part] = module, quick
        return known[1]

    def _kind(self, question: Question, number: int) -> tuple[Any, ...]:
        """What questions must have in common to be answered together."""
        if isinstance(question, Fuse):
            config = self.networks.volume.config
            alike = None not in (config.coarse.cells, config.fine.cells)
            # Volumes whose voxels have a size of their own are as large as their object.
            return Fuse, question.views.features.shape[1:], alike or number
        return (Run, number) if isinstance(question, Run) else (type(question),)

    def _together(self, kind: type, questions: Sequence[Question]) -> Sequence[Any]:
        if kind is Run:
            return [question.work() for question in questions]
        with self.autocast():
            if kind is Detect:
                return self._detect(questions)
            return self._encode(questions) if kind is Encode else self._fuse(questions)

    def _detect(self, questions: Sequence[Detect]) -> list[tuple[np.ndarray, np.ndarray]]:
        logits, regression = self._network("detector")(_pictures([q.picture for q in questions]))
        return list(zip(logits.float().numpy(), regression.float().numpy(), strict=True))

    def _encode(self, questions: Sequence[Encode]) -> list[EncodedCrops]:
        answers: list[EncodedCrops] = []
        for few in _portions(questions):
            counts = [len(q.crops) for q in few]
            crops = _pictures([crop for q in few for crop in q.crops])
            network = self._network("features")
            pyramid = network.encoder.pyramid(crops)
            objects = torch.tensor([q.index for q in few for _ in q.crops])
            features = network.decode(pyramid, objects)
            for count, end in zip(counts, np.cumsum(counts), strict=True):
                own = Features2D(*(part[end - count : end] for part in features))
                levels = tuple(level[end - count : end] for level in pyramid)
                votes = (part.double().numpy() for part in vote(own))
                answers.append(EncodedCrops(own, levels, *votes))
        return answers

    def _fuse(self, questions: Sequence[Fuse]) -> list[LevelOutput]:
        parts = zip(*(question.views for question in questions), strict=True)
        views = ViewMaps(*(torch.cat(part) for part in parts))
        guesses = torch.from_numpy(np.stack([q.guess for q in questions])).float()
        diameters = torch.tensor([q.diameter for q in questions], dtype=torch.float32)
        fine = self._network("volume")(views, guesses, diameters)[-1]
        return [LevelOutput(*(part[n : n + 1] for part in fine)) for n in range(len(questions))]


def _portions(questions: Sequence[Encode]) -> Iterator[list[Encode]]:
    """Questions a few at a time, so that what is computed of their crops stays in the cache."""
    few: list[Encode] = []
    for question in questions:
        few.append(question)
        if sum(len(q.crops) for q in few) >= _CROPS_AT_ONCE:
            yield few
            few = []
    if few:
        yield few


def _pictures(pictures: Sequence[np.ndarray]) -> Tensor:
    """Pictures (H, W, 3) uint8 as a batch (B, 3, H, W) float32, channels last."""
    batch = torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2)
    return batch.float().contiguous(memory_format=torch.channels_last)
