"""From a full frame to 2D keypoints: detect, crop, features, votes. All methods begin here."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from .crops import warp_crop
from .detector import decode, decode_peaks, detector_input
from .estimate import Roi
from .geometry import View, crop_matrix, grid_matrix, turn_matrix
from .inference import Ask, Detect, Encode, EncodedCrops, Inference
from .joint_detection import choose_together, sizes_together
from .networks import PoseNetworks
from .recently_used import RecentlyUsed

CACHED_VIEWS = 4
"""Views of one estimate at a time that are remembered."""

_TURNS = (0.5, -0.5, 1.0, -1.0, 1.5, -1.5)
"""Turns in radians of the crops that are tried where the upright one is not sure."""

_SURE = 0.85
"""Share of votes that agree from which on an upright crop is believed."""

_SURER = 0.03
"""How much surer a turned crop must be to be taken instead."""

_SAME_SIZE = 0.08
"""Logarithm of the ratio of two regions' sides up to which another crop is not worth its time."""

_MERGE_FLOOR = 0.3
"""Variance in grid pixels that several crops' votes are given at least when they are averaged."""


@dataclass(frozen=True, eq=False)
class EncodedView:
    """One view of one object after the 2D part.

    Attributes:
        view: the picture and its camera.
        roi: where the object was found.
        K_grid: (3, 3) camera whose pixels are those of the feature grid.
        to_image: (3, 3) affine map from the feature grid to pixels of the picture.
        volume: (C, G, G) features for the volume.
        vote_mean: (9, 2) voted keypoints, pixels of the feature grid.
        vote_covariance: (9, 2, 2).
        vote_score: (9,) share of the object's pixels that agree, 0 to 1.
        mask: (G, G) probability of the visible object.
        decoder: (W, G, G) the last map of the 2D network.
        maps: the encoder's maps of the crop, (C, S, S) at strides 2 to 32.
        turn: of the crop in the plane of the picture, radians.
    """

    view: View
    roi: Roi
    K_grid: np.ndarray
    to_image: np.ndarray
    volume: Tensor
    vote_mean: np.ndarray
    vote_covariance: np.ndarray
    vote_score: np.ndarray
    mask: np.ndarray
    decoder: Tensor | None = None
    maps: tuple[Tensor, ...] = ()
    turn: float = 0.0

    @property
    def pixels(self) -> np.ndarray:
        """Voted keypoints in pixels of the picture, (9, 2)."""
        return self.vote_mean @ self.to_image[:2, :2].T + self.to_image[:2, 2]

    @property
    def pixel_covariance(self) -> np.ndarray:
        """Covariances of ``pixels``, (9, 2, 2)."""
        A = self.to_image[:2, :2]
        return A @ self.vote_covariance @ A.T


class DetectorMaps(NamedTuple):
    """The detector's answer for one frame.

    Attributes:
        logits: (N, 30, 40) of each object's heat map.
        regression: (N, 3, 30, 40), see ``Detector.forward``.
        to_image: (3, 3), from the detector's input to the picture.
    """

    logits: np.ndarray
    regression: np.ndarray
    to_image: np.ndarray


class Frontend:
    """Runs the 2D networks; remembers the views used last, so that a reference is encoded once.

    Args:
        networks: in evaluation mode.
        ask: what the networks are asked with; None asks them at once.
    """

    def __init__(self, networks: PoseNetworks, ask: Ask | None = None) -> None:
        self.networks = networks
        self.encoded: RecentlyUsed[EncodedView] = RecentlyUsed(CACHED_VIEWS)
        self.detected: RecentlyUsed[DetectorMaps] = RecentlyUsed(CACHED_VIEWS)
        self._ask = Inference(networks).ask if ask is None else ask

    def asking(self, ask: Ask) -> Frontend:
        """This one, which remembers the same views but asks in another way."""
        other = copy(self)
        other._ask = ask
        return other

    def encode(self, view: View, index: int, roi: Roi | None = None) -> EncodedView:
        """Finds an object in a view and votes for its keypoints.

        The network knows objects as cameras see them that are held about level. Where its votes do
        not agree, the crop is turned, and the turn with the surest votes is taken.

        Args:
            view: picture and camera.
            index: which object, in the networks' order.
            roi: a region of interest from elsewhere, instead of the detector's.
        """
        known = self.encoded.get(view, index) if roi is None else None
        if known is not None:
            return known
        region = roi or self.detect(view, index)
        [encoded] = self.encode_turned(view, index, region, (0.0,))
        if encoded.vote_score.mean() < _SURE:
            turned = self.encode_turned(view, index, region, _TURNS)
            surest = max(turned, key=lambda e: float(e.vote_score.mean()))
            if surest.vote_score.mean() > encoded.vote_score.mean() + _SURER:
                encoded = surest
        if roi is None:
            self.encoded.put(view, index, encoded)
        return encoded

    def detect(self, view: View, index: int) -> Roi:
        """The region of interest of an object in a full frame."""
        maps = self.detector_maps(view)
        config = self.networks.detector.config
        return decode(maps.logits[index], maps.regression[index], maps.to_image, config)

    def regions(self, views: Sequence[View], index: int) -> list[Roi | None]:
        """Where an object is in several full frames, found together.

        Args:
            views: the reference first; their cameras are known.
            index: which object, in the networks' order.

        Returns:
            A region for each view; None where it is about the one that :meth:`detect` finds alone.
        """
        config = self.networks.detector.config
        model = list(self.networks.objects.values())[index]
        candidates = []
        for view in views:
            maps = self.detector_maps(view)
            candidates.append(
                decode_peaks(maps.logits[index], maps.regression[index], maps.to_image, config)
            )
        scale = self.networks.features.config.roi_scale
        chosen = choose_together(candidates, views, model.diameter, scale)
        found = [regions[number] for regions, number in zip(candidates, chosen, strict=True)]
        sized = sizes_together(found, views, model.diameter, scale)
        return [
            None if number == 0 and abs(np.log(new.side / old.side)) < _SAME_SIZE else new
            for number, old, new in zip(chosen, found, sized, strict=True)
        ]

    def detector_maps(self, view: View) -> DetectorMaps:
        """What the detector says of all objects in a full frame; the last few are remembered."""
        found = self.detected.get(view)
        if found is None:
            small, to_image = detector_input(view.image, self.networks.detector.config)
            logits, regression = self._ask(Detect(small))
            found = DetectorMaps(logits, regression, to_image)
            self.detected.put(view, None, found)
        return found

    def encode_turned(
        self, view: View, index: int, roi: Roi, turns: Sequence[float]
    ) -> list[EncodedView]:
        """Votes in several crops of one region, as one batch.

        Args:
            view: picture and camera.
            index: which object, in the networks' order.
            roi: where it is.
            turns: how far each crop is turned in the plane of the picture, radians.
        """
        config = self.networks.features.config
        upright = crop_matrix(roi.centre, roi.side, config.crop)
        to_crops = [turn_matrix(turn, config.crop) @ upright for turn in turns]
        crops = np.stack([warp_crop(view.image, A, config.crop) for A in to_crops])
        found: EncodedCrops = self._ask(Encode(crops, index))
        encoded = []
        for n, (to_crop, turn) in enumerate(zip(to_crops, turns, strict=True)):
            to_grid = grid_matrix(config.stride) @ to_crop
            encoded.append(
                EncodedView(
                    view=view,
                    roi=roi,
                    K_grid=to_grid @ view.K,
                    to_image=np.linalg.inv(to_grid),
                    volume=found.features.volume[n].float(),
                    vote_mean=found.mean[n],
                    vote_covariance=found.covariance[n],
                    vote_score=found.score[n],
                    mask=torch.sigmoid(found.features.mask_logits[n].float()).numpy(),
                    decoder=found.features.decoder[n],
                    maps=tuple(level[n] for level in found.pyramid),
                    turn=turn,
                )
            )
        return encoded


def merge_votes(
    view: EncodedView, others: Sequence[EncodedView], permutations: np.ndarray
) -> EncodedView:
    """Averages the votes of several crops of one picture, each keypoint by its covariances.

    Args:
        view: the crop whose grid and features the result keeps.
        others: further crops of the same picture.
        permutations: (P, 9) the numberings that the object's symmetries allow; each of ``others``
            takes the one that is nearest to ``view``.

    Returns:
        ``view`` with the votes of all. Their errors are those of one network on one picture, not
        independent ones, so the covariance is that of one crop.
    """
    means, covariances = [view.vote_mean], [view.vote_covariance]
    for other in others:
        A = np.linalg.inv(view.to_image) @ other.to_image
        moved = (other.vote_mean @ A[:2, :2].T + A[:2, 2])[permutations]
        best = int(np.linalg.norm(moved - view.vote_mean, axis=-1).sum(-1).argmin())
        means.append(moved[best])
        covariances.append(A[:2, :2] @ other.vote_covariance[permutations[best]] @ A[:2, :2].T)
    precision = np.linalg.inv(np.stack(covariances) + _MERGE_FLOOR * np.eye(2))
    covariance = np.linalg.inv(precision.sum(0))
    weighted = np.einsum("vkij,vkj->ki", precision, np.stack(means))
    return replace(
        view,
        vote_mean=np.einsum("kij,kj->ki", covariance, weighted),
        vote_covariance=len(means) * covariance,
    )
