"""Reads BOP datasets (Hodan et al., "BOP: Benchmark for 6D Object Pose Estimation", ECCV 2018;
https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md).

Files hold millimeters. Everything that this package returns or takes is in meters, in the OpenCV
camera frame.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.geometry import check_depth, check_intrinsics
from ...core.images import read_image
from ...core.images import read_mask as read_mask_file
from .boxes import Box
from .fields import MAX_VISIBLE, MM, Place, is_id, read_json, refuse, rigid
from .gt_info import measure_masks
from .layouts import holds_shards
from .pairs import BopPair as BopPair
from .pairs import read_pairs as read_pairs
from .scene import Scene, read_scene


@dataclass(frozen=True, eq=False)
class BopAnnotation:
    """One object in one image.

    Attributes:
        T_cam_obj: object to camera, (4, 4), meters.
        visibility: visible fraction of the silhouette, 0 to 1; pixels outside the image count as
            invisible.
        bbox_visib: box of the visible pixels.
        bbox_obj: box of the whole silhouette; it may leave the image.
        px_count_visib: visible pixels.
        px_count_all: pixels of the whole silhouette, including those outside the image.
        mask_visib_path: mask of the visible pixels, where the dataset has masks.

    Without ``scene_gt_info.json``, boxes, counts and visibility are those of `measure_masks`.
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
        depth_path: its depth map, or None.
        depth_scale: millimeters per unit of the depth map.
        K: camera matrix in pixels, (3, 3).
        T_cam_world: world to camera, (4, 4), meters; None where unknown.
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
        """Returns the first annotation of the object, or None where it has none."""
        return next((a for a in self.annotations if a.obj_id == obj_id), None)


@dataclass(frozen=True)
class BopDataset:
    """One split of a dataset; iterating yields its images, one scene read at a time.

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
            InputError: if there is no such scene, or one of its files is invalid.
        """
        if scene_id not in self.scene_ids:
            raise InputError(
                f"scene {scene_id} is not in {self.root / self.split}, which holds "
                f"{len(self.scene_ids)} scenes from {self.scene_ids[0]} to {self.scene_ids[-1]}"
            )
        scene = read_scene(self.root / self.split / f"{scene_id:06d}", scene_id)
        assert scene is not None  # read_scene raises where it has no scene
        _check_numbers(scene)
        annotations = _annotations(scene)
        path = scene.camera_path
        known = ~np.isnan(scene.T_cam_world[:, 0, 0])
        ids = scene.image_id[known].tolist()
        worlds = rigid(scene.T_cam_world[known], lambda i: f"{path}: image {ids[i]}: world")
        T_cam_world = dict(zip(ids, worlds, strict=True))
        return {
            image_id: BopImage(
                scene_id=scene_id,
                image_id=image_id,
                rgb_path=scene.images[image_id],
                depth_path=scene.depths.get(image_id),
                depth_scale=float(scale),
                K=check_intrinsics(K, f"{path}: image {image_id}: field 'cam_K'"),
                T_cam_world=T_cam_world.get(image_id),
                annotations=tuple(annotations.get(image_id, ())),
            )
            for image_id, scale, K in zip(
                scene.image_id.tolist(), scene.depth_scale, scene.K, strict=True
            )
        }


def read_dataset(root: str | Path, split: str = "test") -> BopDataset:
    """Opens one split of a BOP dataset.

    Raises:
        InputError: if the split's folder does not exist or holds no scenes.
    """
    folder = Path(root) / split
    if not folder.is_dir():
        others = sorted(
            p.parent.parent.name for p in Path(root).glob("*/[0-9]*/scene_camera*.json")
        )
        hint = f"; available with --split: {', '.join(dict.fromkeys(others))}" if others else ""
        raise InputError(f"dataset has no split {split!r}: {folder} is not a folder{hint}")
    scene_ids = sorted(int(p.name) for p in folder.iterdir() if is_id(p.name) and p.is_dir())
    if not scene_ids and holds_shards(folder):
        raise InputError(
            f"{folder} is in BOP's webdataset format (*.tar); download the scenewise files "
            "(folders such as 000000)"
        )
    if not scene_ids:
        raise InputError(f"{folder} holds no scenes (folders such as 000000)")
    return BopDataset(Path(root), split, tuple(scene_ids))


def require_masks(dataset: BopDataset) -> None:
    """Raises where a scene with poses has no masks of the visible pixels, which training needs.

    Raises:
        InputError: names the first such scene.
    """
    scenes = (dataset.root / dataset.split / f"{i:06d}" for i in dataset.scene_ids)
    for scene in scenes:
        poses = scene / "scene_gt.json"
        if (scene / "mask_visib").is_dir() or not poses.is_file():
            continue
        if any(read_json(poses, dict).values()):
            raise InputError(
                f"{scene} has no masks (mask_visib), which training needs: download them, or "
                "render them with bop_toolkit's calc_gt_masks.py; generate writes them unless "
                "--no-masks is given"
            )


def read_rgb(image: BopImage) -> np.ndarray:
    """Returns the image as RGB uint8, (H, W, 3), in stored pixels: EXIF orientation is ignored.

    Raises:
        OSError: if the file cannot be opened.
        InputError: if it cannot be decoded.
    """
    return read_image(image.rgb_path)


def read_depth(image: BopImage) -> np.ndarray:
    """Returns the depth map in meters as float32, (H, W); 0 where unknown.

    Raises:
        OSError: if the file cannot be opened.
        InputError: if the image has no depth map, or the file is invalid.
    """
    if image.depth_path is None:
        raise InputError(f"scene {image.scene_id}, image {image.image_id} has no depth map")
    steps = read_image(image.depth_path, None)
    return check_depth(steps * (image.depth_scale / MM), steps.shape)


def read_mask(annotation: BopAnnotation) -> np.ndarray:
    """Returns the mask of the object's visible pixels, bool (H, W).

    Raises:
        OSError: if the file cannot be opened.
        InputError: if the dataset has no masks, or the file is invalid.
    """
    if annotation.mask_visib_path is None:
        raise InputError(f"the dataset has no mask of object {annotation.obj_id}")
    return read_mask_file(annotation.mask_visib_path)


def _check_numbers(scene: Scene) -> None:
    """Refuses numbers that the linter reports with their probable cause."""
    for image_id, scale in zip(scene.image_id.tolist(), scene.depth_scale, strict=True):
        if scale <= 0:
            place = Place(scene.scene_id, image_id)
            refuse(
                scene.camera_path, "depth_scale", f"must be positive, got {scale:g}", place=place
            )
    visible = scene.annotations.visibility
    for row in np.flatnonzero((visible < 0) | (visible > MAX_VISIBLE)).tolist():
        problem = f"must be 0 to 1, got {visible[row]:g}"
        refuse(scene.info_path, "visib_fract", problem, place=scene.place(row))


def _annotations(scene: Scene) -> dict[int, list[BopAnnotation]]:
    """Returns image id -> its annotations."""
    rows = scene.annotations if scene.annotations.has_info else measure_masks(scene)
    T_cam_obj = rigid(
        rows.T_cam_obj, lambda row: f"{scene.gt_path}: {scene.place(row)}: field 'cam_R_m2c'"
    )
    has_masks = (scene.folder / "mask_visib").is_dir()
    annotations: dict[int, list[BopAnnotation]] = {}
    for row, image_id in enumerate(rows.image_id.tolist()):
        annotations.setdefault(image_id, []).append(
            BopAnnotation(
                obj_id=int(rows.obj_id[row]),
                T_cam_obj=T_cam_obj[row],
                visibility=min(float(rows.visibility[row]), 1.0),
                bbox_visib=tuple(rows.bbox_visib[row].astype(int).tolist()),
                bbox_obj=tuple(rows.bbox_obj[row].astype(int).tolist()),
                px_count_visib=int(rows.px_count_visib[row]),
                px_count_all=int(rows.px_count_all[row]),
                mask_visib_path=scene.mask_path(row) if has_masks else None,
            )
        )
    return annotations
