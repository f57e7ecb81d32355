"""BOP datasets: their records, and reading them.

The format is that of the BOP benchmark (Hodan et al., "BOP: Benchmark for 6D Object Pose
Estimation", ECCV 2018; https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md).
Files hold millimeters; this module and those called ``bop_...`` beside it are the only places that
know it. Everything they return or take is in meters, in the OpenCV camera frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.geometry import check_intrinsics
from ...core.images import read_image
from .boxes import Box
from .fields import MM, rigid
from .gt_info import measure_masks
from .pairs import BopPair as BopPair
from .pairs import read_pairs as read_pairs
from .scene import Scene, read_scene


@dataclass(frozen=True, eq=False)
class BopAnnotation:
    """One object in one image.

    Attributes:
        obj_id: the object's number.
        T_cam_obj: object to camera, (4, 4), meters.
        visibility: visible fraction of the silhouette, 0 to 1. What lies outside of the image
            counts as invisible.
        bbox_visib: box of the visible pixels.
        bbox_obj: box of the whole silhouette; it may leave the image.
        px_count_visib: visible pixels.
        px_count_all: pixels of the whole silhouette, also those outside of the image.
        mask_visib_path: mask of the visible pixels, where the dataset has masks.

    Where the dataset has no ``scene_gt_info.json``, ``bop_info`` says what stands in for it.
    """

    obj_id: int
    T_cam_obj: np.ndarray
    visibility: float
    bbox_visib: Box
    bbox_obj: Box
    px_count_visib: int
    px_count_all: int
    mask_visib_path: Path | None = None


@dataclass(frozen=True, eq=False)
class BopImage:
    """One image, its camera and the objects in it.

    Attributes:
        scene_id: number of the scene folder.
        image_id: number of the image in its scene.
        rgb_path: the image.
        depth_path: its depth map, or None.
        depth_scale: millimeters for each step of the depth map.
        K: camera matrix in pixels, (3, 3).
        T_cam_world: world to camera, (4, 4), meters; None where the dataset does not say.
        annotations: in the file's order.
    """

    scene_id: int
    image_id: int
    rgb_path: Path
    depth_path: Path | None
    depth_scale: float
    K: np.ndarray
    T_cam_world: np.ndarray | None
    annotations: tuple[BopAnnotation, ...]

    def annotation(self, obj_id: int) -> BopAnnotation | None:
        """The first annotation of the object, or None where it is not in the image."""
        return next((a for a in self.annotations if a.obj_id == obj_id), None)


@dataclass(frozen=True)
class BopDataset:
    """One split of a dataset; iterating it reads scene after scene.

    Attributes:
        root: the dataset's folder.
        split: such as ``test`` or ``train_pbr``.
        scene_ids: its scenes, ascending.
    """

    root: Path
    split: str
    scene_ids: tuple[int, ...]

    def __iter__(self) -> Iterator[BopImage]:
        for scene_id in self.scene_ids:
            yield from self.scene(scene_id).values()

    def scene(self, scene_id: int) -> dict[int, BopImage]:
        """Reads one scene: image id -> image, ascending.

        Raises:
            InputError: if there is no such scene, or one of its files is broken.
        """
        if scene_id not in self.scene_ids:
            raise InputError(
                f"scene {scene_id} is not in {self.root / self.split}, which holds "
                f"{len(self.scene_ids)} scenes from {self.scene_ids[0]} to {self.scene_ids[-1]}"
            )
        return _read_scene(self.root / self.split / f"{scene_id:06d}", scene_id)


def read_dataset(root: str | Path, split: str = "test") -> BopDataset:
    """Opens one split of a BOP dataset.

    Raises:
        InputError: if the split's folder does not exist or holds no scenes.
    """
    folder = Path(root) / split
    if not folder.is_dir():
        others = sorted(p.parent.parent.name for p in Path(root).glob("*/[0-9]*/scene_camera.json"))
        there = f"; there is {', '.join(dict.fromkeys(others))}: say so with --split"
        raise InputError(
            f"dataset has no split {split!r}: {folder} is not a folder{there if others else ''}"
        )
    scene_ids = sorted(int(p.name) for p in folder.iterdir() if p.name.isdigit() and p.is_dir())
    if not scene_ids:
        raise InputError(f"{folder} holds no scenes (folders such as 000000)")
    return BopDataset(Path(root), split, tuple(scene_ids))


def read_rgb(image: BopImage) -> np.ndarray:
    """The image as RGB uint8, (H, W, 3).

    Raises:
        OSError: if the file cannot be opened.
        InputError: if it cannot be decoded.
    """
    return read_image(image.rgb_path)


def read_depth(image: BopImage) -> np.ndarray:
    """The depth map in meters as float32, (H, W); 0 where there is none.

    Raises:
        OSError: if the file cannot be opened.
        InputError: if the dataset holds no depth for this image, or the file is broken.
    """
    if image.depth_path is None:
        raise InputError(f"scene {image.scene_id}, image {image.image_id} has no depth map")
    steps = read_image(image.depth_path, None)
    return (steps * (image.depth_scale / MM)).astype(np.float32)


def read_mask(annotation: BopAnnotation) -> np.ndarray:
    """Mask of the object's visible pixels, bool (H, W).

    Raises:
        OSError: if the file cannot be opened.
        InputError: if the dataset holds no masks, or the file is broken.
    """
    if annotation.mask_visib_path is None:
        raise InputError(f"the dataset has no mask of object {annotation.obj_id}")
    return read_image(annotation.mask_visib_path, "L") > 0


def _read_scene(folder: Path, scene_id: int) -> dict[int, BopImage]:
    scene = read_scene(folder, scene_id)
    assert scene is not None  # else it has raised
    annotations = _annotations(scene)
    path = scene.camera_path
    known = np.flatnonzero(~np.isnan(scene.T_cam_world[:, 0, 0]))
    T_cam_world = dict.fromkeys(scene.image_id.tolist())
    worlds = rigid(
        scene.T_cam_world[known], lambda i: f"{path}: image {scene.image_id[known[i]]}: world"
    )
    T_cam_world |= dict(zip(scene.image_id[known].tolist(), worlds, strict=True))
    return {
        image_id: BopImage(
            scene_id=scene_id,
            image_id=image_id,
            rgb_path=scene.images[image_id],
            depth_path=scene.depths.get(image_id),
            depth_scale=float(scale),
            K=check_intrinsics(K, f"{path}: image {image_id}: field 'cam_K'"),
            T_cam_world=T_cam_world[image_id],
            annotations=tuple(annotations.get(image_id, ())),
        )
        for image_id, scale, K in zip(
            scene.image_id.tolist(), scene.depth_scale, scene.K, strict=True
        )
    }


def _annotations(scene: Scene) -> dict[int, list[BopAnnotation]]:
    """Image id -> its annotations."""
    rows = scene.annotations if scene.annotations.described else measure_masks(scene)
    T_cam_obj = rigid(
        rows.T_cam_obj, lambda row: f"{scene.gt_path}: {scene.place(row)}: field 'cam_R_m2c'"
    )
    masked = (scene.folder / "mask_visib").is_dir()
    annotations: dict[int, list[BopAnnotation]] = {}
    for row, image_id in enumerate(rows.image_id.tolist()):
        annotations.setdefault(image_id, []).append(
            BopAnnotation(
                obj_id=int(rows.obj_id[row]),
                T_cam_obj=T_cam_obj[row],
                visibility=float(rows.visibility[row]),
                bbox_visib=tuple(rows.bbox_visib[row].astype(int).tolist()),
                bbox_obj=tuple(rows.bbox_obj[row].astype(int).tolist()),
                px_count_visib=int(rows.px_count_visib[row]),
                px_count_all=int(rows.px_count_all[row]),
                mask_visib_path=scene.mask_path(row) if masked else None,
            )
        )
    return annotations
