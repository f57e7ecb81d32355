"""Finds two-view pairs of a BOP dataset that has no list of them.

The relative camera pose comes from the cameras' world poses (``cam_R_w2c``), else from the objects:
where two or more keep their relative pose from one image to the next, they are static and give the
camera's motion.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.geometry import invert
from .dataset import BopDataset, BopImage
from .models_info import read_models_info
from .pairs import PAIRS_FILE, BopPair, read_pairs
from .targets import MIN_VISIBLE_FRACTION

MAX_STATIC_METERS = 0.005
MAX_STATIC_DEGREES = 2.0
"""An object whose pose deviates more from that of a static object has moved."""

MAX_SYMMETRIES = 8
"""Objects with more symmetries do not propose a camera motion from their symmetric poses."""

BASELINES = (10.0, 60.0)
"""Smallest and largest baseline angle in degrees, the mean over the static objects."""

MAX_PAIRS_PER_REFERENCE = 4
"""Pairs with one reference view; they are spread over the baselines."""

MAX_IMAGES = 200
"""Images of a scene to pair, by gaps reference images; a longer scene is subsampled evenly."""


def find_pairs(
    dataset: BopDataset, pairs: Path | None = None, gaps: Sequence[int] = ()
) -> tuple[BopPair, ...]:
    """Returns the pairs of a split: those of a file where there is one, else those found.

    The result is deterministic.

    Args:
        dataset: the split.
        pairs: a file of pairs; None = ``two_view_pairs.json`` of the dataset where it has one.
        gaps: pair images whose numbers differ by these, whatever the baseline, instead.

    Raises:
        InputError: if a file is invalid, or no pair is found.
    """
    if not gaps and (pairs is not None or (dataset.root / PAIRS_FILE).is_file()):
        return read_pairs(pairs or dataset.root)
    symmetries = _read_symmetries(dataset.root)
    found: list[BopPair] = []
    for scene_id in dataset.scene_ids:
        found += pairs_of_scene(list(dataset.scene(scene_id).values()), symmetries, gaps)
    if not found and gaps:
        raise InputError(
            f"{dataset.root / dataset.split} has no two images of a static object whose numbers "
            f"differ by {', '.join(map(str, gaps))}"
        )
    if not found:
        low, high = BASELINES
        raise InputError(
            f"{dataset.root / dataset.split} has no {PAIRS_FILE}, and no two images of a scene "
            f"show a static object from {low:g} to {high:g} degrees apart"
        )
    return tuple(found)


def pairs_of_scene(
    images: Sequence[BopImage], symmetries: Mapping[int, np.ndarray], gaps: Sequence[int] = ()
) -> list[BopPair]:
    """Returns the pairs of one scene, sorted by reference view, and by baseline or gap.

    The camera's motion comes from the world poses where all images have one. Else each object in
    both images proposes a motion, and the one with most inlier objects is used; with a single
    object its motion is used. Objects that an image shows twice are ignored as ambiguous.

    Args:
        images: of the scene, ascending.
        symmetries: obj_id -> symmetry transforms (S, 4, 4), identity first.
        gaps: differences between the numbers of paired images; none: by baseline.
    """
    if len(images) > MAX_IMAGES and not gaps:
        images = [images[i] for i in _spread(len(images))]
    scene = _Scene(images, symmetries)
    indices = {image.image_id: index for index, image in enumerate(images)}
    found = []
    for reference in _spread(len(images)):
        visible = scene.visibility[reference] >= MIN_VISIBLE_FRACTION
        T_second_ref, static = scene.motions(reference)
        baselines = scene.baselines(reference, T_second_ref)
        static &= visible
        static[reference] = False
        seconds: dict[int, int | None]
        if gaps:
            numbers = {gap: images[reference].image_id + gap for gap in gaps}
            seconds = {indices[n]: gap for gap, n in numbers.items() if n in indices}
        else:
            seconds = dict.fromkeys(_by_baseline(static, baselines))
        for second, gap in seconds.items():
            if static[second].any():
                found.append(
                    BopPair(
                        scene_id=images[reference].scene_id,
                        ref_image_id=images[reference].image_id,
                        second_image_id=images[second].image_id,
                        T_second_ref=T_second_ref[second],
                        gap=gap,
                        baselines_deg={
                            scene.obj_ids[o]: float(baselines[second, o])
                            for o in np.flatnonzero(static[second])
                        },
                    )
                )
    return found


def _spread(count: int) -> list[int]:
    """Returns at most ``MAX_IMAGES`` of so many indices, evenly spaced."""
    return np.linspace(0, count - 1, min(count, MAX_IMAGES)).round().astype(int).tolist()


def _by_baseline(static: np.ndarray, baselines: np.ndarray) -> list[int]:
    """Returns the second views of a reference view within ``BASELINES``, spread over them."""
    count = static.sum(axis=1)
    mean = np.where(static, baselines, 0).sum(axis=1) / np.maximum(count, 1)
    within = (mean >= BASELINES[0]) & (mean <= BASELINES[1])
    seconds = np.flatnonzero((count > 0) & within)
    seconds = seconds[np.argsort(mean[seconds], kind="stable")]
    if len(seconds) > MAX_PAIRS_PER_REFERENCE:
        chosen = np.arange(MAX_PAIRS_PER_REFERENCE) + 0.5
        seconds = seconds[(chosen * len(seconds) / MAX_PAIRS_PER_REFERENCE).astype(int)]
    return seconds.tolist()


class _Scene:
    """The poses of a scene as arrays (images, objects, ...); NaN where an object is not shown."""

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
        worlds = [image.T_cam_world for image in images if image.T_cam_world is not None]
        self.T_cam_world = np.stack(worlds) if 0 < len(worlds) == len(images) else None

    def motions(self, reference: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns T_second_ref (N, 4, 4) for each second view, and static objects, bool (N, O)."""
        if self.T_cam_world is not None:
            T = self.T_cam_world @ invert(self.T_cam_world[reference])
            return T, self._static(reference, T)
        count, objects = self.T.shape[:2]
        best_T = np.tile(np.eye(4), (count, 1, 1))
        best = np.zeros((count, objects), dtype=bool)
        # Objects without symmetry first: the motion that they propose is unambiguous.
        for o in sorted(range(objects), key=lambda o: (len(self.symmetries[o]), o)):
            if np.isnan(self.T[reference, o, 0, 0]):
                continue
            symmetries = self.symmetries[o]
            for S in symmetries if len(symmetries) <= MAX_SYMMETRIES else np.eye(4)[None]:
                T = self.T[:, o] @ S @ invert(self.T[reference, o])
                static = self._static(reference, T)
                better = static.sum(axis=1) > best.sum(axis=1)
                best[better], best_T[better] = static[better], T[better]
        shown = ~np.isnan(self.T[..., 0, 0])
        common = (shown & shown[reference]).sum(axis=1)
        best[(best.sum(axis=1) < 2) & (common > 1)] = False
        return best_T, best

    def _static(self, reference: int, T_second_ref: np.ndarray) -> np.ndarray:
        """Returns which objects (N, O) have the pose that they have if only the camera moved."""
        static = np.zeros(self.T.shape[:2], dtype=bool)
        with np.errstate(invalid="ignore"):
            for o, symmetries in enumerate(self.symmetries):
                expected = (T_second_ref @ self.T[reference, o])[:, None] @ symmetries
                seen = self.T[:, o, None]
                distance = np.linalg.norm(expected[..., :3, 3] - seen[..., :3, 3], axis=-1)
                trace = (expected[..., :3, :3] * seen[..., :3, :3]).sum(axis=(-1, -2))
                angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
                near = (distance <= MAX_STATIC_METERS) & (angle <= np.radians(MAX_STATIC_DEGREES))
                static[:, o] = near.any(axis=1)
        return static

    def baselines(self, reference: int, T_second_ref: np.ndarray) -> np.ndarray:
        """Returns degrees (N, O) between the rays from each object to both cameras."""
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
