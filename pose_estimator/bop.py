"""BOP datasets: their records, and reading them.

The format is that of the BOP benchmark (Hodan et al., "BOP: Benchmark for 6D Object Pose
Estimation", ECCV 2018; https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md).
Files hold millimetres; this module and those called ``bop_...`` beside it are the only places that
know it. Everything they return or take is in metres, in the OpenCV camera frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .bop_boxes import Box
from .bop_fields import MM, array, integer, read_json, required, transforms
from .bop_info import info_from_masks
from .bop_pairs import BopPair as BopPair
from .bop_pairs import read_pairs as read_pairs
from .geometry import check_intrinsics


@dataclass(frozen=True, eq=False)
class BopAnnotation:
    """One object in one picture.

    Attributes:
        obj_id: the object's number.
        T_cam_obj: object to camera, (4, 4), metres.
        visibility: visible fraction of the silhouette, 0 to 1. What lies outside of the picture
            counts as invisible.
        bbox_visib: box of the visible pixels.
        bbox_obj: box of the whole silhouette; it may leave the picture.
        px_count_visib: visible pixels.
        px_count_all: pixels of the whole silhouette, also those outside of the picture.
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
    """One picture, its camera and the objects in it.

    Attributes:
        scene_id: number of the scene folder.
        image_id: number of the picture in its scene.
        rgb_path: the picture.
        depth_path: its depth map, or None.
        depth_scale: millimetres for each step of the depth map.
        K: camera matrix in pixels, (3, 3).
        T_cam_world: world to camera, (4, 4), metres; None where the dataset does not say.
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
        """The first annotation of the object, or None where it is not in the picture."""
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
        """Reads one scene: image id -> picture, ascending.

        Raises:
            ValueError: if there is no such scene, or one of its files is broken.
        """
        if scene_id not in self.scene_ids:
            raise ValueError(
                f"scene {scene_id} is not in {self.root / self.split}, which holds "
                f"{len(self.scene_ids)} scenes from {self.scene_ids[0]} to {self.scene_ids[-1]}"
            )
        return _read_scene(self.root / self.split / f"{scene_id:06d}", scene_id)


def read_dataset(root: str | Path, split: str = "test") -> BopDataset:
    """Opens one split of a BOP dataset.

    Raises:
        ValueError: if the split's folder does not exist or holds no scenes.
    """
    folder = Path(root) / split
    if not folder.is_dir():
        others = sorted(p.parent.parent.name for p in Path(root).glob("*/[0-9]*/scene_camera.json"))
        there = f"; there is {', '.join(dict.fromkeys(others))}: say so with --split"
        raise ValueError(
            f"dataset has no split {split!r}: {folder} is not a folder{there if others else ''}"
        )
    scene_ids = sorted(int(p.name) for p in folder.iterdir() if p.name.isdigit() and p.is_dir())
    if not scene_ids:
        raise ValueError(f"{folder} holds no scenes (folders such as 000000)")
    return BopDataset(Path(root), split, tuple(scene_ids))


def read_rgb(image: BopImage) -> np.ndarray:
    """The picture as RGB uint8, (H, W, 3).

    Raises:
        ValueError: if the file cannot be decoded.
    """
    return np.ascontiguousarray(_decode(image.rgb_path, cv2.IMREAD_COLOR)[..., ::-1])


def read_depth(image: BopImage) -> np.ndarray:
    """The depth map in metres as float32, (H, W); 0 where there is none.

    Raises:
        ValueError: if the dataset holds no depth for this picture, or the file is broken.
    """
    if image.depth_path is None:
        raise ValueError(f"scene {image.scene_id}, image {image.image_id} has no depth map")
    steps = _decode(image.depth_path, cv2.IMREAD_UNCHANGED)
    return (steps * (image.depth_scale / MM)).astype(np.float32)


def read_mask(annotation: BopAnnotation) -> np.ndarray:
    """Mask of the object's visible pixels, bool (H, W).

    Raises:
        ValueError: if the dataset holds no masks, or the file is broken.
    """
    if annotation.mask_visib_path is None:
        raise ValueError(f"the dataset has no mask of object {annotation.obj_id}")
    return _decode(annotation.mask_visib_path, cv2.IMREAD_GRAYSCALE) > 0


def _read_scene(folder: Path, scene_id: int) -> dict[int, BopImage]:
    cameras = read_json(folder / "scene_camera.json", dict)
    poses: dict[str, Any] = {}
    if (folder / "scene_gt.json").exists():
        poses = read_json(folder / "scene_gt.json", dict)
    described = folder / "scene_gt_info.json"
    infos = read_json(described, dict) if described.exists() else info_from_masks(folder, poses)
    if stray := poses.keys() - cameras.keys():
        raise ValueError(
            f"{folder / 'scene_gt.json'}: image {min(stray)} is not in scene_camera.json"
        )
    annotations = _read_annotations(folder, poses, infos)
    # Datasets of monochrome cameras, such as ITODD, have `gray` in the place of `rgb`.
    rgb = folder / "rgb" if (folder / "rgb").is_dir() else folder / "gray"
    pictures, depths = numbered(rgb), numbered(folder / "depth")

    images = {}
    for key in sorted(cameras, key=int):
        camera, image_id = cameras[key], integer(key, str(folder / "scene_camera.json"))
        where = f"{folder / 'scene_camera.json'}: image {key}"
        if image_id not in pictures:
            raise ValueError(f"{where} has no picture in {rgb}")
        K = array([camera], "cam_K", 9, [where]).reshape(3, 3)
        T_cam_world = None
        if "cam_R_w2c" in camera or "cam_t_w2c" in camera:
            T_cam_world = transforms([camera], "cam_R_w2c", "cam_t_w2c", [where])[0]
        scale = camera.get("depth_scale", 1.0)
        images[image_id] = BopImage(
            scene_id=scene_id,
            image_id=image_id,
            rgb_path=pictures[image_id],
            depth_path=depths.get(image_id),
            depth_scale=float(array([{"depth_scale": scale}], "depth_scale", 1, [where])[0, 0]),
            K=check_intrinsics(K, f"{where}: field 'cam_K'"),
            T_cam_world=T_cam_world,
            annotations=tuple(annotations.get(key, ())),
        )
    return images


def _read_annotations(
    folder: Path, poses: Mapping[str, Any], infos: Mapping[str, Any]
) -> dict[str, list[BopAnnotation]]:
    """All annotations of a scene; checked together, because a dataset has many."""
    gt_path, info_path = folder / "scene_gt.json", folder / "scene_gt_info.json"
    rows: list[tuple[str, int, dict, dict]] = []
    for key, entries in poses.items():
        described = required(infos, key, f"{info_path}")
        if len(described) != len(entries):
            raise ValueError(
                f"{info_path}: image {key} has {len(described)} entries, "
                f"but {gt_path.name} has {len(entries)}"
            )
        rows += [(key, i, *both) for i, both in enumerate(zip(entries, described, strict=True))]
    if not rows:
        return {}
    gt = [row[2] for row in rows]
    info = [row[3] for row in rows]
    gt_places = [f"{gt_path}: image {key}, annotation {i}" for key, i, _, _ in rows]
    info_places = [f"{info_path}: image {key}, annotation {i}" for key, i, _, _ in rows]
    T_cam_obj = transforms(gt, "cam_R_m2c", "cam_t_m2c", gt_places)
    obj_ids = array(gt, "obj_id", 1, gt_places)[:, 0].astype(int)
    visibility = array(info, "visib_fract", 1, info_places)[:, 0]
    boxes = [
        array(info, name, 4, info_places).astype(int).tolist()
        for name in ("bbox_visib", "bbox_obj")
    ]
    counts = [
        array(info, name, 1, info_places)[:, 0].astype(int)
        for name in ("px_count_visib", "px_count_all")
    ]
    masks = folder / "mask_visib"
    known = {p.name for p in masks.iterdir()} if masks.is_dir() else None

    annotations: dict[str, list[BopAnnotation]] = {}
    for row, (key, i, _, _) in enumerate(rows):
        name = f"{int(key):06d}_{i:06d}.png"
        if known is not None and name not in known:
            raise ValueError(f"{gt_places[row]} has no mask: {masks / name} is missing")
        annotations.setdefault(key, []).append(
            BopAnnotation(
                obj_id=int(obj_ids[row]),
                T_cam_obj=T_cam_obj[row],
                visibility=float(visibility[row]),
                bbox_visib=tuple(boxes[0][row]),
                bbox_obj=tuple(boxes[1][row]),
                px_count_visib=int(counts[0][row]),
                px_count_all=int(counts[1][row]),
                mask_visib_path=None if known is None else masks / name,
            )
        )
    return annotations


def numbered(folder: Path) -> dict[int, Path]:
    """The pictures of a folder by their number; PNG, JPEG or TIFF."""
    if not folder.is_dir():
        return {}
    suffixes = (".png", ".jpg", ".jpeg", ".tif")
    return {int(p.stem): p for p in folder.iterdir() if p.suffix in suffixes and p.stem.isdigit()}


def _decode(path: Path, flags: int) -> np.ndarray:
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from error
    image = cv2.imdecode(data, flags) if data.size else None
    if image is None:
        raise ValueError(f"{path} is not a readable picture (truncated?)")
    return image
