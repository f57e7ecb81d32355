"""One scene of a BOP dataset as arrays: what its JSON files say and which files lie beside them.

Both ways to read a dataset begin here: `bop` refuses a scene at its first broken field, the linter
reads on (see `bop_fields.Report`). Lengths are in meters; numbers that are missing or broken are
NaN; rotations are left as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .fields import REPAIR, Place, Report, read_json, read_numbers, read_transforms, refuse

UNKNOWN = -(2**31)
"""In the place of an object's number that cannot be read."""

RESTORE = "restore the file, or take its entry out of the JSON files"


@dataclass(eq=False)
class SceneAnnotations:
    """All annotations of a scene, row by row.

    Attributes:
        image_id: (N,) the image each belongs to.
        index: (N,) its position in the image's list.
        obj_id: (N,), ``UNKNOWN`` where it is broken.
        T_cam_obj: (N, 4, 4), meters.
        described: whether the scene has a ``scene_gt_info.json``.
        visibility: (N,).
        bbox_visib: (N, 4) left, top, width, height.
        bbox_obj: (N, 4).
        px_count_visib: (N,).
        px_count_all: (N,).
    """

    image_id: np.ndarray
    index: np.ndarray
    obj_id: np.ndarray
    T_cam_obj: np.ndarray
    described: bool
    visibility: np.ndarray
    bbox_visib: np.ndarray
    bbox_obj: np.ndarray
    px_count_visib: np.ndarray
    px_count_all: np.ndarray


@dataclass(eq=False)
class Scene:
    """One scene as far as it can be read.

    Attributes:
        scene_id: number of the folder.
        folder: the folder.
        image_id: (M,) images that scene_camera.json lists, ascending.
        K: (M, 3, 3).
        depth_scale: (M,) millimeters for each step of the depth maps.
        T_cam_world: (M, 4, 4), meters.
        annotations: of all images.
        images: number -> file, in ``rgb`` or ``gray``.
        depths: number -> file.
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
        """Where a row of the annotations stands."""
        rows = self.annotations
        return Place(self.scene_id, int(rows.image_id[row]), int(rows.index[row]))

    def mask_path(self, row: int, kind: str = "mask_visib") -> Path:
        """The mask of a row of the annotations, whether or not it is there."""
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
    """``rgb``, or ``gray`` of datasets of monochrome cameras such as ITODD."""
    return scene / "rgb" if (scene / "rgb").is_dir() else scene / "gray"


def read_scene(folder: Path, scene_id: int, report: Report = refuse) -> Scene | None:
    """Reads one scene; None where its cameras cannot be read.

    Raises:
        InputError: of ``report``, where something is broken or a file is missing.
    """
    path, gt_path = folder / "scene_camera.json", folder / "scene_gt.json"
    cameras = read_json(path, dict, report)
    poses = (read_json(gt_path, dict, report) if gt_path.exists() else None) or {}
    if cameras is None:
        return None
    keys = _whole(cameras, path, scene_id, report)
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
    images = _numbered(rgb)
    for image_id in sorted(keys.keys() - images.keys()):
        report(
            path, "image", "an image is missing",
            place=Place(scene_id, image_id), remedy=RESTORE,
            detail=f"{rgb.name}/{image_id:06d}.png (or .jpg) is not there",
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
        depths=_numbered(folder / "depth"),
    )


def _read_annotations(
    folder: Path, scene_id: int, poses: Mapping[str, Any], cameras: Mapping[int, str],
    report: Report,
) -> SceneAnnotations:  # fmt: skip
    path, info_path = folder / "scene_gt.json", folder / "scene_gt_info.json"
    keys = _whole(poses, path, scene_id, report)
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
                cause="the JSON files are of different versions, or image numbers were changed",
                remedy="add it to scene_camera.json",
            )  # fmt: skip
        described = [None] * len(entries) if infos is None else infos.get(keys[image_id])
        if not isinstance(described, list) or len(described) != len(entries):
            found = f"{len(described)} entries" if isinstance(described, list) else "no list"
            report(
                info_path, "image", "does not match scene_gt.json", place=place,
                detail=f"{found} for {len(entries)} annotations",
                cause="one of the files is of an older version of the data",
                remedy="compute scene_gt_info.json anew (bop_toolkit: calc_gt_info.py)",
            )  # fmt: skip
            described = [None] * len(entries)
        places += [Place(scene_id, image_id, i) for i in range(len(entries))]
        gt += entries
        info += described
    known = [row for row, entry in enumerate(info) if entry is not None]

    def measured(name: str, size: int) -> np.ndarray:
        values = np.full((len(places), size), np.nan)
        values[known] = read_numbers(
            [info[row] for row in known], name, size, info_path, [places[row] for row in known],
            report,
        )  # fmt: skip
        return values

    _check_masks(folder / "mask_visib", path, places, report)
    obj_id = read_numbers(gt, "obj_id", 1, path, places, report)[:, 0]
    return SceneAnnotations(
        image_id=np.array([place.image for place in places], dtype=int),
        index=np.array([place.annotation for place in places], dtype=int),
        obj_id=np.where(np.isnan(obj_id), UNKNOWN, obj_id).astype(int),
        T_cam_obj=read_transforms(gt, ("cam_R_m2c", "cam_t_m2c"), path, places, report),
        described=infos is not None,
        visibility=measured("visib_fract", 1)[:, 0],
        bbox_visib=measured("bbox_visib", 4),
        bbox_obj=measured("bbox_obj", 4),
        px_count_visib=measured("px_count_visib", 1)[:, 0],
        px_count_all=measured("px_count_all", 1)[:, 0],
    )


def _check_masks(folder: Path, path: Path, places: list[Place], report: Report) -> None:
    """Where there are masks, each annotation must have one."""
    if not folder.is_dir():
        return
    names = {p.name for p in folder.iterdir()}
    for place in places:
        name = f"{place.image:06d}_{place.annotation:06d}.png"
        if name not in names:
            report(
                path, "mask_visib", "a mask is missing", place=place,
                remedy="restore the file (masks are numbered by image and annotation), or take "
                "the annotation out of the JSON files",
                detail=f"mask_visib/{name} is not there",
            )  # fmt: skip


def _whole(content: Mapping[str, Any], path: Path, scene_id: int, report: Report) -> dict[int, str]:
    """Whole number -> key; complains of keys that are none, and of numbers that are there twice."""
    numbers: dict[int, str] = {}
    for key in content:
        if not key.isdigit():
            report(
                path, "keys", "a key must be an image's number", place=Place(scene_id),
                detail=f"key {key[:40]!r}", remedy="rename or remove the entry",
            )  # fmt: skip
        elif int(key) in numbers:
            report(
                path, "keys", "an image is there twice", place=Place(scene_id, int(key)),
                detail=f"keys {numbers[int(key)]!r} and {key!r}",
                remedy="give each image a number of its own",
            )  # fmt: skip
        else:
            numbers[int(key)] = key
    return numbers


def _numbered(folder: Path) -> dict[int, Path]:
    """The images of a folder by their number; PNG, JPEG or TIFF."""
    if not folder.is_dir():
        return {}
    suffixes = (".png", ".jpg", ".jpeg", ".tif")
    return {int(p.stem): p for p in folder.iterdir() if p.suffix in suffixes and p.stem.isdigit()}
