"""Reads one scene of a BOP dataset as arrays.

Used by `dataset`, which raises at the first invalid field, and by the linter, which continues (see
`fields.Report`). Lengths are in meters, invalid numbers are NaN, rotations may be rounded.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .fields import (
    REPAIR,
    Place,
    Report,
    is_id,
    read_ids,
    read_json,
    read_numbers,
    read_transforms,
    refuse,
)
from .layouts import other_layout

UNKNOWN = -(2**31)
"""Stands for an invalid object id."""

RESTORE = "restore the file, or remove its entry from the JSON files"
RECOMPUTE_INFO = "recompute scene_gt_info.json (bop_toolkit: calc_gt_info.py)"


@dataclass(eq=False)
class SceneAnnotations:
    """All annotations of a scene.

    Attributes:
        image_id: (N,) the annotation's image.
        index: (N,) its position in the image's list.
        obj_id: (N,), ``UNKNOWN`` where invalid.
        T_cam_obj: (N, 4, 4), meters.
        has_info: whether the scene has a ``scene_gt_info.json``.
        visibility: (N,) visible fractions.
        bbox_visib: (N, 4) left, top, width, height.
        bbox_obj: (N, 4).
        px_count_visib: (N,).
        px_count_all: (N,).
    """

    image_id: np.ndarray
    index: np.ndarray
    obj_id: np.ndarray
    T_cam_obj: np.ndarray
    has_info: bool
    visibility: np.ndarray
    bbox_visib: np.ndarray
    bbox_obj: np.ndarray
    px_count_visib: np.ndarray
    px_count_all: np.ndarray


@dataclass(eq=False)
class Scene:
    """The readable part of one scene.

    Attributes:
        image_id: (M,) images that scene_camera.json lists, ascending.
        K: (M, 3, 3).
        depth_scale: (M,) millimeters per unit of the depth maps.
        T_cam_world: (M, 4, 4), meters.
        annotations: of all images.
        images: image id -> file, in ``rgb`` or ``gray``.
        depths: image id -> file.
    """

    scene_id: int
    folder: Path
    image_id: np.ndarray
    K: np.ndarray
    depth_scale: np.ndarray
    T_cam_world: np.ndarray
    annotations: SceneAnnotations
    images: dict[int, Path]
    depths: dict[int, Path]

    def place(self, row: int) -> Place:
        """Returns the location of a row of the annotations."""
        rows = self.annotations
        return Place(self.scene_id, int(rows.image_id[row]), int(rows.index[row]))

    def mask_path(self, row: int, kind: str = "mask_visib") -> Path:
        """Returns the path of the mask of a row of the annotations, which may not exist."""
        rows = self.annotations
        return self.folder / kind / f"{rows.image_id[row]:06d}_{rows.index[row]:06d}.png"

    @property
    def gt_path(self) -> Path:
        """``scene_gt.json``."""
        return self.folder / "scene_gt.json"

    @property
    def info_path(self) -> Path:
        """``scene_gt_info.json``."""
        return self.folder / "scene_gt_info.json"

    @property
    def camera_path(self) -> Path:
        """``scene_camera.json``."""
        return self.folder / "scene_camera.json"


def image_folder(scene: Path) -> Path:
    """Returns the folder ``rgb``, or ``gray`` of monochrome datasets such as ITODD."""
    return scene / "rgb" if (scene / "rgb").is_dir() else scene / "gray"


def read_scene(folder: Path, scene_id: int, report: Report = refuse) -> Scene | None:
    """Reads one scene; returns None where its scene_camera.json is invalid, or of several cameras.

    Raises:
        InputError: by the default ``report``, where a field is invalid or a file is missing.
    """
    path, gt_path = folder / "scene_camera.json", folder / "scene_gt.json"
    if not path.exists() or not image_folder(folder).is_dir():
        other = other_layout(folder)
        if other is not None:
            report(
                folder / "rgb" if path.exists() else path, "file", other.problem,
                place=Place(scene_id), detail=other.remedy, remedy=other.remedy,
            )  # fmt: skip
            return None
    cameras = read_json(path, dict, report)
    poses = (read_json(gt_path, dict, report) if gt_path.exists() else None) or {}
    if cameras is None:
        return None
    keys = _image_keys(cameras, path, scene_id, report)
    image_ids = sorted(keys)
    rows = [cameras[keys[i]] for i in image_ids]
    places = [Place(scene_id, i) for i in image_ids]
    K = read_numbers(rows, "cam_K", 9, path, places, report)
    scale = read_numbers(rows, "depth_scale", 1, path, places, report, optional=True)[:, 0]
    names = "cam_R_w2c", "cam_t_w2c"
    T_cam_world = np.full((len(rows), 4, 4), np.nan)
    known = [i for i, row in enumerate(rows) if isinstance(row, dict) and row.keys() & {*names}]
    T_cam_world[known] = read_transforms(
        [rows[i] for i in known], names, path, [places[i] for i in known], report
    )
    rgb = image_folder(folder)
    images = _images_by_id(rgb)
    for image_id in sorted(keys.keys() - images.keys()):
        report(
            path, "image", "an image is missing", place=Place(scene_id, image_id), remedy=RESTORE,
            detail=f"no file {rgb.name}/{image_id:06d}.png (or .jpg)",
        )  # fmt: skip
    return Scene(
        scene_id=scene_id,
        folder=folder,
        image_id=np.array(image_ids, dtype=int),
        K=K.reshape(-1, 3, 3),
        depth_scale=np.where(np.isnan(scale), 1.0, scale),
        T_cam_world=T_cam_world,
        annotations=_read_annotations(folder, scene_id, poses, keys, report),
        images=images,
        depths=_images_by_id(folder / "depth"),
    )


def _read_annotations(
    folder: Path, scene_id: int, poses: Mapping[str, Any], cameras: Mapping[int, str],
    report: Report,
) -> SceneAnnotations:  # fmt: skip
    path, info_path = folder / "scene_gt.json", folder / "scene_gt_info.json"
    keys = _image_keys(poses, path, scene_id, report)
    infos = read_json(info_path, dict, report) if info_path.exists() else None
    places: list[Place] = []
    gt: list[Any] = []
    info: list[Any] = []
    for image_id in sorted(keys):
        entries, place = poses[keys[image_id]], Place(scene_id, image_id)
        if not isinstance(entries, list):
            report(path, "image", "must be a list of annotations", place=place, remedy=REPAIR)
            continue
        if image_id not in cameras:
            report(
                path, "image", "an annotated image has no camera", place=place,
                detail="scene_camera.json does not list it",
                cause="the JSON files are of different versions, or image ids were changed",
                remedy="add it to scene_camera.json",
            )  # fmt: skip
        of_image = [None] * len(entries) if infos is None else infos.get(keys[image_id])
        if not isinstance(of_image, list) or len(of_image) != len(entries):
            found = f"{len(of_image)} entries" if isinstance(of_image, list) else "no list"
            report(
                info_path, "image", "does not match scene_gt.json", place=place,
                detail=f"{found} for {len(entries)} annotations",
                cause="one of the files is of an older version of the data", remedy=RECOMPUTE_INFO,
            )  # fmt: skip
            of_image = [None] * len(entries)
        places += [Place(scene_id, image_id, i) for i in range(len(entries))]
        gt += entries
        info += of_image
    known = [row for row, entry in enumerate(info) if entry is not None]
    known_info, known_places = [info[row] for row in known], [places[row] for row in known]

    def read_info(name: str, size: int) -> np.ndarray:
        values = np.full((len(places), size), np.nan)
        values[known] = read_numbers(known_info, name, size, info_path, known_places, report)
        return values

    _check_masks(folder / "mask_visib", path, places, report)
    obj_id = read_ids(gt, "obj_id", path, places, report)
    return SceneAnnotations(
        image_id=np.array([place.image for place in places], dtype=int),
        index=np.array([place.annotation for place in places], dtype=int),
        obj_id=np.where(np.isnan(obj_id), UNKNOWN, obj_id).astype(int),
        T_cam_obj=read_transforms(gt, ("cam_R_m2c", "cam_t_m2c"), path, places, report),
        has_info=infos is not None,
        visibility=read_info("visib_fract", 1)[:, 0],
        bbox_visib=read_info("bbox_visib", 4),
        bbox_obj=read_info("bbox_obj", 4),
        px_count_visib=read_info("px_count_visib", 1)[:, 0],
        px_count_all=read_info("px_count_all", 1)[:, 0],
    )


def _check_masks(folder: Path, path: Path, places: list[Place], report: Report) -> None:
    """Checks that each annotation has a mask, where the scene has masks."""
    if not folder.is_dir():
        return
    names = {p.name for p in folder.iterdir()}
    for place in places:
        name = f"{place.image:06d}_{place.annotation:06d}.png"
        if name not in names:
            report(
                path, "mask_visib", "a mask is missing", place=place,
                remedy=f"{RESTORE} (masks are named by image and annotation)",
                detail=f"no file mask_visib/{name}",
            )  # fmt: skip


def _image_keys(
    content: Mapping[str, Any], path: Path, scene_id: int, report: Report
) -> dict[int, str]:
    """Returns image id -> key; reports keys that are not integers and duplicated ids."""
    keys: dict[int, str] = {}
    for key in content:
        if not is_id(key):
            report(
                path, "keys", "a key must be an image's id", place=Place(scene_id),
                detail=f"key {key[:40]!r}", remedy="rename or remove the entry",
            )  # fmt: skip
        elif int(key) in keys:
            report(
                path, "keys", "an image is duplicated", place=Place(scene_id, int(key)),
                detail=f"keys {keys[int(key)]!r} and {key!r}",
                remedy="give each image an id of its own",
            )  # fmt: skip
        else:
            keys[int(key)] = key
    return keys


def _images_by_id(folder: Path) -> dict[int, Path]:
    """Returns image id -> PNG, JPEG or TIFF file of a folder."""
    if not folder.is_dir():
        return {}
    suffixes = (".png", ".jpg", ".jpeg", ".tif")
    return {
        int(p.stem): p for p in folder.iterdir() if p.suffix.lower() in suffixes and is_id(p.stem)
    }
