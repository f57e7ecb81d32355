"""From full frames to voted 2D keypoints: detection, crops, features, votes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...core.geometry import View, crop_matrix, grid_matrix, rotation_matrix_2d
from ...core.image_crop import warp_crop
from ..networks.container import PoseNetworks
from ..networks.detector import decode, decode_peaks, detector_input
from ..networks.inference import EncodedCrop, Inference
from ..types import Roi
from .joint_detection import associate_detections, refine_roi_scales
from .lru_cache import LruCache

_MIN_CACHED_VIEWS = 4
"""Smallest size of the caches."""

_ROLLS = (0.5, -0.5, 1.0, -1.0, 1.5, -1.5)
"""Rotations in radians of the crops that are tried if the upright one is not confident."""

_CONFIDENT_SCORE = 0.85
"""Mean vote score at which no rotated crops are tried."""

_MIN_SCORE_GAIN = 0.03
"""Smallest gain in score for which a rotated crop is used."""

_LOG_SCALE_TOLERANCE = 0.08
"""Smaller changes of a region's log side need no new crop."""

_MIN_MERGED_VARIANCE = 0.3
"""Added to the variance of votes that are averaged, square grid pixels."""


@dataclass(frozen=True, eq=False, kw_only=True)
class EncodedView(EncodedCrop):
    """An object in a view, encoded by the 2D networks.

    Attributes:
        view: image and camera.
        roi: the detected region.
        K_grid: (3, 3) camera matrix of the feature grid.
        to_image: (3, 3) affine map from the feature grid to pixels of the image.
        roll: rotation of the crop in the image plane, radians.
    """

    view: View
    roi: Roi
    K_grid: np.ndarray
    to_image: np.ndarray
    roll: float = 0.0

    @property
    def pixels(self) -> np.ndarray:
        """Voted keypoints in pixels of the image, (9, 2)."""
        return self.vote_mean @ self.to_image[:2, :2].T + self.to_image[:2, 2]

    @property
    def pixel_covariance(self) -> np.ndarray:
        """Covariances of ``pixels``, (9, 2, 2)."""
        A = self.to_image[:2, :2]
        return A @ self.vote_covariance @ A.T


class DetectorMaps(NamedTuple):
    """The detector's output for a frame.

    Attributes:
        logits: of each object's heat map, (N, 30, 40).
        regression: (N, 3, 30, 40), see ``Detector.forward``.
        to_image: (3, 3), from the detector's input to pixels of the image.
    """

    logits: np.ndarray
    regression: np.ndarray
    to_image: np.ndarray


class Target(NamedTuple):
    """An object to be found in a view.

    Attributes:
        view: image and camera.
        obj: index of the object in the networks.
        roi: its region; None: detect it.
    """

    view: View
    obj: int
    roi: Roi | None = None


class Frontend:
    """Runs the 2D networks, and caches the last views, so that a reference is encoded once."""

    def __init__(self, networks: PoseNetworks, inference: Inference | None = None) -> None:
        self.networks = networks
        self.encoded: LruCache[EncodedView] = LruCache(_MIN_CACHED_VIEWS)
        self.detected: LruCache[DetectorMaps] = LruCache(_MIN_CACHED_VIEWS)
        self._inference = Inference(networks) if inference is None else inference

    def encode(self, targets: Sequence[Target]) -> list[EncodedView]:
        """Detects objects in views and votes for their keypoints.

        The network is trained on nearly level cameras. If its votes do not agree, the crop is
        rotated and the rotation of the highest score is used (test-time augmentation).
        """
        self._grow_caches(len(targets))
        found: list[EncodedView | None] = [
            self.encoded.get(t.view, t.obj) if t.roi is None else None for t in targets
        ]
        # A view that occurs twice, as the reference of several pairs, is encoded once.
        missing: dict[tuple[int, int, int], list[int]] = {}
        for number, target in enumerate(targets):
            if found[number] is None:
                known = -1 if target.roi is None else number
                missing.setdefault((id(target.view), target.obj, known), []).append(number)
        first = [targets[numbers[0]] for numbers in missing.values()]
        maps = iter(self.detector_maps([t.view for t in first if t.roi is None]))
        config = self.networks.detector.config
        located = []
        for target in first:
            if target.roi is None:
                logits, regression, to_image = next(maps)
                roi = decode(logits[target.obj], regression[target.obj], to_image, config)
                target = target._replace(roi=roi)
            located.append(target)
        upright = self._best_rolls(located)
        for numbers, encoded in zip(missing.values(), upright, strict=True):
            for number in numbers:
                found[number] = encoded
            target = targets[numbers[0]]
            if target.roi is None:
                self.encoded.put(target.view, target.obj, encoded)
        return [encoded for encoded in found if encoded is not None]

    def regions(self, requests: Sequence[tuple[Sequence[View], int]]) -> list[list[Roi | None]]:
        """Detects an object in several views jointly.

        Args:
            requests: views, the reference first, and the object's index in the networks.

        Returns:
            For each request a region for each view; None where the view's own detection agrees.
        """
        every = [view for views, _ in requests for view in views]
        self._grow_caches(len(every))
        maps = iter(self.detector_maps(every))
        return [self._regions(vs, index, [next(maps) for _ in vs]) for vs, index in requests]

    def detector_maps(self, views: Sequence[View]) -> list[DetectorMaps]:
        """Returns the detector's output for full frames; the last few are cached."""
        known = {id(view): self.detected.get(view) for view in views}
        new = list({id(view): view for view in views if known[id(view)] is None}.values())
        inputs = [detector_input(view.image, self.networks.detector.config) for view in new]
        answers = self._inference.detect([small for small, _ in inputs])
        for view, (_, to_image), answer in zip(new, inputs, answers, strict=True):
            known[id(view)] = found = DetectorMaps(*answer, to_image)
            self.detected.put(view, None, found)
        return [maps for view in views if (maps := known[id(view)]) is not None]

    def encode_rotated(
        self, targets: Sequence[Target], rolls: Sequence[Sequence[float]]
    ) -> list[list[EncodedView]]:
        """Votes in several crops of each target's region, rotated by ``rolls`` (radians)."""
        config = self.networks.features.config
        matrices = []
        for target, own in zip(targets, rolls, strict=True):
            assert target.roi is not None
            upright = crop_matrix(target.roi.center, target.roi.side, config.crop)
            matrices.append([rotation_matrix_2d(roll, config.crop) @ upright for roll in own])
        crops = [
            (np.stack([warp_crop(t.view.image, A, config.crop) for A in to_crops]), t.obj)
            for t, to_crops in zip(targets, matrices, strict=True)
        ]
        found = self._inference.encode(crops)
        return [
            [self._encoded_view(target, *crop) for crop in zip(own, to_crops, encoded, strict=True)]
            for target, own, to_crops, encoded in zip(targets, rolls, matrices, found, strict=True)
        ]

    def _grow_caches(self, views: int) -> None:
        for cache in (self.encoded, self.detected):
            cache.maxsize = max(cache.maxsize, 2 * views)

    def _regions(
        self, views: Sequence[View], index: int, maps: Sequence[DetectorMaps]
    ) -> list[Roi | None]:
        config = self.networks.detector.config
        model = list(self.networks.objects.values())[index]
        candidates = [
            decode_peaks(m.logits[index], m.regression[index], m.to_image, config) for m in maps
        ]
        scale = self.networks.features.config.roi_scale
        chosen = associate_detections(candidates, views, model.diameter, scale)
        found = [regions[number] for regions, number in zip(candidates, chosen, strict=True)]
        sized = refine_roi_scales(found, views, model.diameter, scale)
        return [
            None if number == 0 and abs(np.log(new.side / old.side)) < _LOG_SCALE_TOLERANCE else new
            for number, old, new in zip(chosen, found, sized, strict=True)
        ]

    def _best_rolls(self, targets: Sequence[Target]) -> list[EncodedView]:
        """Encodes regions upright, or rotated where that gives a higher score."""
        encoded = [only for [only] in self.encode_rotated(targets, [(0.0,)] * len(targets))]
        uncertain = [n for n, e in enumerate(encoded) if e.vote_score.mean() < _CONFIDENT_SCORE]
        tried = self.encode_rotated([targets[n] for n in uncertain], [_ROLLS] * len(uncertain))
        for n, rotated in zip(uncertain, tried, strict=True):
            best = max(rotated, key=lambda e: float(e.vote_score.mean()))
            if best.vote_score.mean() > encoded[n].vote_score.mean() + _MIN_SCORE_GAIN:
                encoded[n] = best
        return encoded

    def _encoded_view(
        self, target: Target, roll: float, to_crop: np.ndarray, crop: EncodedCrop
    ) -> EncodedView:
        assert target.roi is not None
        to_grid = grid_matrix(self.networks.features.config.stride) @ to_crop
        return EncodedView(
            **vars(crop),
            view=target.view,
            roi=target.roi,
            K_grid=to_grid @ target.view.K,
            to_image=np.linalg.inv(to_grid),
            roll=roll,
        )


def merge_votes(
    view: EncodedView, others: Sequence[EncodedView], permutations: np.ndarray
) -> EncodedView:
    """Averages the votes of several crops of one image, weighted by their covariances.

    Args:
        view: the crop whose grid and features the result keeps.
        others: further crops of the same image.
        permutations: (P, 9) of the object's symmetries; for each of ``others`` the one nearest to
            ``view`` is used.

    Returns:
        ``view`` with the averaged votes. Errors of one network on one image are not independent,
        so the covariance is that of a single crop.
    """
    means, covariances = [view.vote_mean], [view.vote_covariance]
    for other in others:
        A = np.linalg.inv(view.to_image) @ other.to_image
        moved = (other.vote_mean @ A[:2, :2].T + A[:2, 2])[permutations]
        best = int(np.linalg.norm(moved - view.vote_mean, axis=-1).sum(-1).argmin())
        means.append(moved[best])
        covariances.append(A[:2, :2] @ other.vote_covariance[permutations[best]] @ A[:2, :2].T)
    precision = np.linalg.inv(np.stack(covariances) + _MIN_MERGED_VARIANCE * np.eye(2))
    covariance = np.linalg.inv(precision.sum(0))
    weighted = np.einsum("vkij,vkj->ki", precision, np.stack(means))
    return replace(
        view,
        vote_mean=np.einsum("kij,kj->ki", covariance, weighted),
        vote_covariance=len(means) * covariance,
    )
