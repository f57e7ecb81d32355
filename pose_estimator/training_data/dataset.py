"""Training samples from a pack of crops: single targets, pairs of views, and whole frames."""

from collections.abc import Mapping

import cv2
import numpy as np

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.geometry import invert, project, transform
from ..networks.detector import DetectorConfig, detection_targets
from ..networks.features import FeatureConfig
from ..symmetry import canonical_pose
from .augmentation import (
    AugmentationConfig,
    augment_colors,
    erase_box,
    jitter_affine,
    jitter_frame,
    paint_spots,
    recolor_side,
)
from .crops import STORED_SCALE, STORED_SIDE, CropPack
from .cut_and_paste import CropPaster, CutAndPasteConfig
from .target_sample import TargetSample, direction_field

_OUTLINE_POINTS = 400
"""Number of surface points for the outline of a recolored side."""

_TILTED = 0.2
"""Weight of targets whose +z axis is tilted by more than ten degrees in the dataset's world: most
objects stand upright, as in LineMOD."""

_OCCLUDED = 0.4
"""Weight of targets with a visibility below 30 percent."""

_GRAY = (127, 127, 127)


def sampling_weights(pack: CropPack) -> np.ndarray:
    """Returns the sampling weights (T,) of the targets, relative to an upright, visible one."""
    T_world_cam = invert(pack.T_cam_world[pack.frame_index])
    up = np.einsum("ti,ti->t", T_world_cam[:, 2, :3], pack.T_cam_obj[:, :3, 2])
    # Without a world pose, tilt is undefined.
    no_world = (T_world_cam == np.eye(4)).all((1, 2))
    weights = np.where((up > np.cos(np.radians(10))) | no_world, 1.0, _TILTED)
    return weights * np.where(pack.visibility < 0.3, _OCCLUDED, 1.0)


class TrainingSet:
    """Draws training samples from a pack.

    Args:
        pack: the packed dataset.
        objects: the models, in the order of the pack.
        features: shape of the crops.
        augmentation: None = no augmentation, with crops centered on the target.
        validation: fraction of the scenes (the last ones) that is held out.
        held_out: draw from the held-out scenes instead of the training scenes.
        cut_and_paste: None = no cut-and-paste.

    Raises:
        InputError: if there are too few scenes, or there is nothing to paste.
    """

    def __init__(
        self,
        pack: CropPack,
        objects: Mapping[str, ObjectModel],
        features: FeatureConfig,
        augmentation: AugmentationConfig | None = AugmentationConfig(),
        *,
        validation: float = 0.03,
        held_out: bool = False,
        cut_and_paste: CutAndPasteConfig | None = None,
    ):
        self.pack = pack
        self.models = list(objects.values())
        self.features = features
        self.augmentation = augmentation
        scenes = np.unique(pack.scene_id)
        kept = max(1, round(validation * len(scenes)))
        if kept >= len(scenes):
            raise InputError(
                f"the dataset has {len(scenes)} scene{'s' * (len(scenes) > 1)}, and {kept} of them "
                "would be kept for validation: nothing would be left to train on. Generate more "
                "scenes (2 at least), or lower --validation"
            )
        first_held_out = scenes[len(scenes) - kept]
        self.frames = np.flatnonzero((pack.scene_id >= first_held_out) == held_out)
        self.targets = np.flatnonzero(np.isin(pack.frame_index, self.frames))
        index = pack.object_index[self.targets]
        self.by_object = [self.targets[index == k] for k in range(len(self.models))]
        self.known = [k for k, targets in enumerate(self.by_object) if len(targets)]
        self._paster = (
            None if cut_and_paste is None else CropPaster(pack, self.targets, cut_and_paste)
        )
        weights = sampling_weights(pack)
        self._weights = [_normalized(weights[targets]) for targets in self.by_object]
        self._pairs = self._find_pairs()
        self._pair_weights = [
            _normalized(np.array([weights[group].mean() for group in groups]))
            for groups in self._pairs
        ]

    def _find_pairs(self) -> list[list[np.ndarray]]:
        """For each object, the groups of targets in the same scene."""
        groups: dict[tuple[int, int], list[int]] = {}
        for target in self.targets:
            scene = int(self.pack.scene_id[self.pack.frame_index[target]])
            groups.setdefault((int(self.pack.object_index[target]), scene), []).append(int(target))
        result: list[list[np.ndarray]] = [[] for _ in self.models]
        for (index, _), group in sorted(groups.items()):
            if len(group) > 1:
                result[index].append(np.array(group))
        return result

    def target(
        self, target: int, rng: np.random.Generator, *, with_depth: bool = True
    ) -> TargetSample:
        """Returns an augmented sample; without depth, decoding takes half the time."""
        pack, config = self.pack, self.features
        size = config.crop
        zoom = STORED_SCALE / config.roi_scale * size / STORED_SIDE
        crop, mask = pack.crop(target), pack.mask(target)
        depth = pack.depth(target) if with_depth else None
        if self.augmentation is None:
            around = np.diag([zoom, zoom, 1.0])
        else:
            around = jitter_affine(size, zoom, self.augmentation, rng)
        affine = _shift((size - 1) / 2) @ around @ _shift(-(STORED_SIDE - 1) / 2)
        crop = cv2.warpAffine(crop, affine[:2], (size, size), borderValue=_GRAY)
        mask = cv2.warpAffine(mask, affine[:2], (size, size))
        if depth is not None:
            depth = cv2.warpAffine(depth, affine[:2], (size, size), flags=cv2.INTER_NEAREST)
        index = int(pack.object_index[target])
        model = self.models[index]
        K = affine @ pack.to_stored[target] @ pack.K[pack.frame_index[target]]
        T = canonical_pose(pack.T_cam_obj[target], model.symmetries)
        if self._paster is not None:
            crop, mask, depth = self._paster.paste(crop, mask, depth, index, rng)
        if self.augmentation is not None:
            crop = paint_spots(self.augmentation, rng, crop, mask)
            points = model.points[:: len(model.points) // _OUTLINE_POINTS + 1]
            pixels = project(transform(T, points), K)
            view = -T[:3, :3].T @ T[:3, 3]
            crop = recolor_side(self.augmentation, rng, crop, mask, points, pixels, view)
            erase_box(self.augmentation, rng, crop, mask, depth)
            crop = augment_colors(crop, self.augmentation, rng)
        mask = cv2.resize(mask, (config.grid, config.grid), interpolation=cv2.INTER_AREA)
        pixels = project(transform(T, model.keypoints), K)
        return TargetSample(
            crop=crop,
            mask=mask.astype(np.float32) / 255,
            directions=direction_field(pixels, config),
            object_index=index,
            K=K,
            T_cam_obj=T,
            depth=depth,
        )

    def draw_object(self, rng: np.random.Generator) -> int:
        """Draws the index of an object; each one of the dataset is equally likely."""
        return int(rng.choice(self.known))

    def draw_target(
        self, rng: np.random.Generator, index: int | None = None, *, with_depth: bool = True
    ) -> TargetSample:
        """Draws a target of object ``index``, by default of :meth:`draw_object`."""
        index = self.draw_object(rng) if index is None else index
        target = int(rng.choice(self.by_object[index], p=self._weights[index]))
        return self.target(target, rng, with_depth=with_depth)

    def draw_pair(
        self, rng: np.random.Generator, *, with_depth: bool = True
    ) -> tuple[TargetSample, TargetSample, np.ndarray]:
        """Draws two views of one object: reference view, second view and T_second_ref (4, 4).

        Raises:
            InputError: if no scene shows an object in two images.
        """
        if not any(self._pairs):
            raise InputError(
                "no scene of the dataset shows an object in two images, and two views are "
                "trained: generate --views 2 at least"
            )
        index = rng.choice([k for k in self.known if self._pairs[k]])
        groups = self._pairs[index]
        group = groups[rng.choice(len(groups), p=self._pair_weights[index])]
        first, second = rng.choice(group, 2, replace=False)
        # From the static object, since real data may lack world poses.
        T_second_ref = self.pack.T_cam_obj[second] @ invert(self.pack.T_cam_obj[first])
        views = (self.target(int(n), rng, with_depth=with_depth) for n in (first, second))
        return next(views), next(views), T_second_ref

    def draw_frame(
        self, rng: np.random.Generator, config: DetectorConfig
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Draws a frame: image, heat, regression, weight (see :func:`detection_targets`)."""
        pack = self.pack
        frame = int(rng.choice(self.frames))
        image = pack.frame(frame)
        low, high = np.searchsorted(pack.frame_index, [frame, frame + 1])
        if self._paster is not None:
            image = self._paster.paste_frame(image, frame, rng)
        affine = np.eye(3)
        if self.augmentation is not None:
            size = config.width, config.height
            affine = jitter_frame(size, self.augmentation, rng)
            image = cv2.warpAffine(image, affine[:2], size, borderValue=_GRAY)
            erase_box(self.augmentation, rng, image)
            image = augment_colors(image, self.augmentation, rng)
        K = affine @ np.linalg.inv(pack.frame_to_image[frame]) @ pack.K[frame]
        count = len(self.models)
        centers, sides = np.zeros((count, 2)), np.ones(count)
        present = np.zeros(count, bool)
        for target in range(low, high):
            index, T = pack.object_index[target], pack.T_cam_obj[target]
            centers[index] = project(T[:3, 3], K)
            focal = np.sqrt(abs(np.linalg.det(K[:2, :2])))
            sides[index] = config.roi_scale * self.models[index].diameter * focal / T[2, 3]
            present[index] = True
        return (image, *detection_targets(centers, sides, present, config))


def _normalized(weights: np.ndarray) -> np.ndarray:
    return weights / weights.sum() if len(weights) else weights


def _shift(offset: float) -> np.ndarray:
    return np.array([[1.0, 0, offset], [0, 1.0, offset], [0, 0, 1.0]])
