"""Two-view pairs of any BOP dataset, also of one that comes without a list of them.

Which two images make a pair is taken from ``two_view_pairs.json``; else from the cameras' poses
in the world (``cam_R_w2c``); else from the objects: where two or more keep their places to each
other from one image to the next, they stood still, and how the camera moved follows from them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.geometry import invert
from .dataset import BopDataset, BopImage
from .models_info import read_models_info
from .pairs import PAIRS_FILE, BopPair, read_pairs
from .targets import LEAST_VISIBLE

STILL_METERS = 0.005
STILL_DEGREES = 2.0
"""An object that is farther from where it would be if it had stood still was moved."""

MAX_SYMMETRIES = 8
"""An object with more symmetries than that does not say how the camera moved."""


BASELINES = (10.0, 60.0)
"""Smallest and largest angle in degrees between the two rays from an object to the cameras, in the
mean over the objects that stood still."""

MAX_PER_REFERENCE = 4
"""Most pairs with one reference view; they are spread over the baselines."""

MAX_IMAGES = 200
"""Of a longer scene so many images, evenly spread, are looked at."""


def find_pairs(dataset: BopDataset, pairs: Path | None = None) -> tuple[BopPair, ...]:
    """The pairs of a split: those that a file lists, else those that can be found.

    The same files give the same pairs.

    Args:
        dataset: the split.
        pairs: a file of pairs; none = ``two_view_pairs.json`` of the dataset where it has one.

    Raises:
        InputError: if a file is broken, or no pair can be found.
    """
    if pairs is not None or (dataset.root / PAIRS_FILE).is_file():
        return read_pairs(pairs or dataset.root)
    symmetries = _read_symmetries(dataset.root)
    found: list[BopPair] = []
    for scene_id in dataset.scene_ids:
        found += pairs_of_scene(list(dataset.scene(scene_id).values()), symmetries)
    if not found:
        low, high = BASELINES
        raise InputError(
            f"{dataset.root / dataset.split} has no {PAIRS_FILE}, and no two images of a scene "
            f"show an object that stood still from {low:g} to {high:g} degrees apart"
        )
    return tuple(found)


def pairs_of_scene(
    images: Sequence[BopImage], symmetries: Mapping[int, np.ndarray]
) -> list[BopPair]:
    """The pairs of one scene, by reference view and rising baseline.

    Where all images know their cameras in the world, that is how the camera moved. Else each
    object that both images show proposes a motion, and the one that most objects agree with is
    taken; the motion of a single object is taken as it is. Objects that an image shows twice are
    left out, since which one is meant cannot be told.

    Args:
        images: of the scene, ascending.
        symmetries: obj_id -> transforms (S, 4, 4) under which it looks the same, identity first.
    """
    if len(images) > MAX_IMAGES:
        chosen = np.linspace(0, len(images) - 1, MAX_IMAGES).round().astype(int)
        images = [images[i] for i in chosen]
    scene = _Scene(images, symmetries)
    found = []
    for reference in range(len(images)):
        visible = scene.visibility[reference] >= LEAST_VISIBLE
        T_second_ref, still = scene.motions(reference)
        baselines = scene.baselines(reference, T_second_ref)
        still &= visible
        still[reference] = False
        count = still.sum(axis=1)
        mean = np.where(still, baselines, 0).sum(axis=1) / np.maximum(count, 1)
        within = (mean >= BASELINES[0]) & (mean <= BASELINES[1])
        seconds = np.flatnonzero((count > 0) & within)
        seconds = seconds[np.argsort(mean[seconds], kind="stable")]
        if len(seconds) > MAX_PER_REFERENCE:
            places = (np.arange(MAX_PER_REFERENCE) + 0.5) * len(seconds) / MAX_PER_REFERENCE
            seconds = seconds[places.astype(int)]
        for second in seconds.tolist():
            found.append(
                BopPair(
                    scene_id=images[reference].scene_id,
                    ref_image_id=images[reference].image_id,
                    second_image_id=images[second].image_id,
                    T_second_ref=T_second_ref[second],
                    baselines_deg={
                        scene.obj_ids[o]: float(baselines[second, o])
                        for o in np.flatnonzero(still[second])
                    },
                )
            )
    return found


class _Scene:
    """The poses of a scene as arrays: images by objects; NaN where an object is not shown."""

    def __init__(self, images: Sequence[BopImage], symmetries: Mapping[int, np.ndarray]):
        shown = [[a.obj_id for a in image.annotations] for image in images]
        self.obj_ids = sorted({obj_id for ids in shown for obj_id in ids})
        column = {obj_id: o for o, obj_id in enumerate(self.obj_ids)}
        self.symmetries = [symmetries.get(i, np.eye(4)[None]) for i in self.obj_ids]
        self.T = np.full((len(images), len(self.obj_ids), 4, 4), np.nan)
        self.visibility = np.zeros(self.T.shape[:2])
        for i, image in enumerate(images):
            for a in image.annotations:
                if shown[i].count(a.obj_id) == 1:
                    self.T[i, column[a.obj_id]] = a.T_cam_obj
                    self.visibility[i, column[a.obj_id]] = a.visibility
        self.T_cam_world: np.ndarray | None = None
        worlds = [image.T_cam_world for image in images if image.T_cam_world is not None]
        if worlds and len(worlds) == len(images):
            self.T_cam_world = np.stack(worlds)

    def motions(self, reference: int) -> tuple[np.ndarray, np.ndarray]:
        """T_second_ref (N, 4, 4) for every second view, and what stood still, bool (N, O)."""
        if self.T_cam_world is not None:
            T = self.T_cam_world @ invert(self.T_cam_world[reference])
            return T, self._still(reference, T)
        count, objects = self.T.shape[:2]
        best_T = np.tile(np.eye(4), (count, 1, 1))
        best = np.zeros((count, objects), dtype=bool)
        # Objects without symmetry first: they say with certainty how the camera moved.
        for o in sorted(range(objects), key=lambda o: (len(self.symmetries[o]), o)):
            if np.isnan(self.T[reference, o, 0, 0]):
                continue
            turns = (
                self.symmetries[o] if len(self.symmetries[o]) <= MAX_SYMMETRIES else np.eye(4)[None]
            )
            for S in turns:
                T = self.T[:, o] @ S @ invert(self.T[reference, o])
                still = self._still(reference, T)
                better = still.sum(axis=1) > best.sum(axis=1)
                best[better], best_T[better] = still[better], T[better]
        shown = ~np.isnan(self.T[..., 0, 0])
        common = (shown & shown[reference]).sum(axis=1)
        best[(best.sum(axis=1) < 2) & (common > 1)] = False
        return best_T, best

    def _still(self, reference: int, T_second_ref: np.ndarray) -> np.ndarray:
        """Which objects (N, O) are where they would be if only the camera had moved."""
        still = np.zeros(self.T.shape[:2], dtype=bool)
        with np.errstate(invalid="ignore"):
            for o, symmetries in enumerate(self.symmetries):
                expected = (T_second_ref @ self.T[reference, o])[:, None] @ symmetries
                seen = self.T[:, o, None]
                distance = np.linalg.norm(expected[..., :3, 3] - seen[..., :3, 3], axis=-1)
                trace = (expected[..., :3, :3] * seen[..., :3, :3]).sum(axis=(-1, -2))
                angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
                near = (distance <= STILL_METERS) & (angle <= np.radians(STILL_DEGREES))
                still[:, o] = near.any(axis=1)
        return still

    def baselines(self, reference: int, T_second_ref: np.ndarray) -> np.ndarray:
        """Degrees (N, O) between the rays from each object to both cameras."""
        centers = self.T[reference, :, :3, 3]
        camera = invert(T_second_ref)[:, None, :3, 3]  # the second camera in the reference frame
        first, second = -centers[None], camera - centers[None]
        lengths = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
        cosine = (first * second).sum(axis=-1) / np.maximum(lengths, 1e-12)
        return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def _read_symmetries(root: Path) -> dict[int, np.ndarray]:
    for folder in ("models", "models_eval"):
        if (root / folder / "models_info.json").is_file():
            infos = read_models_info(root, folder)
            return {obj_id: info.symmetries for obj_id, info in infos.items()}
    return {}
