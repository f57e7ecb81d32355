"""Reading BOP files that may be damaged: all that can be read, and a finding for what cannot.

``bop`` refuses a scene at its first broken field; a linter has to read on. Like ``bop``, this is a
place that knows of millimetres on the disk: all that it returns is in metres. Numbers that are
missing or broken are NaN. Rotations are left as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .bop import numbered
from .bop_fields import MM
from .bop_raw_fields import REPAIR, read_numbers, read_raw_json
from .data_findings import Findings, Place

UNKNOWN = -(2**31)
"""In the place of an object's number that cannot be read."""


@dataclass(eq=False)
class RawAnnotations:
    """All annotations of a scene, row by row.

    Attributes:
        image_id: (N,) the picture each belongs to.
        index: (N,) its position in the picture's list.
        obj_id: (N,), ``UNKNOWN`` where it is broken.
        T_cam_obj: (N, 4, 4), metres.
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

    def place(self, scene_id: int, row: int) -> Place:
        """Where a row stands."""
        return Place(scene_id, int(self.image_id[row]), int(self.index[row]))


@dataclass(eq=False)
class RawScene:
    """One scene as far as it can be read.

    Attributes:
        scene_id: number of the folder.
        folder: the folder.
        image_id: (M,) pictures that scene_camera.json lists, ascending.
        K: (M, 3, 3).
        depth_scale: (M,) millimetres for each step of the depth maps.
        T_cam_world: (M, 4, 4), metres.
        annotations: of all pictures.
        pictures: number -> file, in ``rgb`` or ``gray``.
        depths: number -> file.
    """

    scene_id: int
    folder: Path
    image_id: np.ndarray
    K: np.ndarray
    depth_scale: np.ndarray
    T_cam_world: np.ndarray
    annotations: RawAnnotations
    pictures: dict[int, Path] = field(default_factory=dict)
    depths: dict[int, Path] = field(default_factory=dict)

    def depth(self, image_id: int, steps: np.ndarray) -> np.ndarray:
        """Steps of a picture's depth map (H, W) as metres."""
        return steps * (self.depth_scale[self.image_id == image_id][0] / MM)

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


def read_raw_scene(folder: Path, scene_id: int, findings: Findings) -> RawScene | None:
    """Reads one scene; None where its cameras cannot be read."""
    cameras = read_raw_json(folder / "scene_camera.json", dict, findings)
    gt_path = folder / "scene_gt.json"
    poses = read_raw_json(gt_path, dict, findings) if gt_path.exists() else {}
    if cameras is None:
        return None
    path = folder / "scene_camera.json"
    keys = _whole(cameras, path, scene_id, findings)
    image_ids = sorted(keys)
    rows = [cameras[keys[i]] for i in image_ids]
    places = [Place(scene_id, i) for i in image_ids]
    K = read_numbers(rows, "cam_K", 9, path, places, findings)
    scale = read_numbers(rows, "depth_scale", 1, path, places, findings, optional=True)[:, 0]
    T = _poses(rows, ("cam_R_w2c", "cam_t_w2c"), path, places, findings, optional=True)
    rgb = folder / "rgb" if (folder / "rgb").is_dir() else folder / "gray"
    return RawScene(
        scene_id=scene_id,
        folder=folder,
        image_id=np.array(image_ids, dtype=int),
        K=K.reshape(-1, 3, 3),
        depth_scale=np.where(np.isnan(scale), 1.0, scale),
        T_cam_world=T,
        annotations=_read_annotations(folder, scene_id, poses or {}, findings),
        pictures=numbered(rgb),
        depths=numbered(folder / "depth"),
    )


def _read_annotations(
    folder: Path, scene_id: int, poses: Mapping[str, Any], findings: Findings
) -> RawAnnotations:
    path, info_path = folder / "scene_gt.json", folder / "scene_gt_info.json"
    keys = _whole(poses, path, scene_id, findings)
    infos = read_raw_json(info_path, dict, findings) if info_path.exists() else None
    places, gt, info = [], [], []
    for image_id in sorted(keys):
        entries = poses[keys[image_id]]
        if not isinstance(entries, list):
            findings.error(
                path, "image", "must be a list of annotations", place=Place(scene_id, image_id),
                remedy=REPAIR,
            )  # fmt: skip
            continue
        described = _described(infos, keys[image_id], len(entries), info_path, findings, scene_id)
        places += [Place(scene_id, image_id, i) for i in range(len(entries))]
        gt += entries
        info += described
    known = [row for row, entry in enumerate(info) if entry is not None]

    def measured(name: str, size: int) -> np.ndarray:
        values = np.full((len(places), size), np.nan)
        values[known] = read_numbers(
            [info[row] for row in known], name, size, info_path, [places[row] for row in known],
            findings,
        )  # fmt: skip
        return values

    obj_id = read_numbers(gt, "obj_id", 1, path, places, findings)[:, 0]
    return RawAnnotations(
        image_id=np.array([place.image for place in places], dtype=int),
        index=np.array([place.annotation for place in places], dtype=int),
        obj_id=np.where(np.isnan(obj_id), UNKNOWN, obj_id).astype(int),
        T_cam_obj=_poses(gt, ("cam_R_m2c", "cam_t_m2c"), path, places, findings),
        described=infos is not None,
        visibility=measured("visib_fract", 1)[:, 0],
        bbox_visib=measured("bbox_visib", 4),
        bbox_obj=measured("bbox_obj", 4),
        px_count_visib=measured("px_count_visib", 1)[:, 0],
        px_count_all=measured("px_count_all", 1)[:, 0],
    )


def _described(
    infos: Mapping[str, Any] | None,
    key: str,
    count: int,
    path: Path,
    findings: Findings,
    scene_id: int,
) -> list[Any]:
    """The entries of scene_gt_info.json that go with a picture's annotations, None for unknown."""
    if infos is None:
        return [None] * count
    entries = infos.get(key)
    if isinstance(entries, list) and len(entries) == count:
        return entries
    found = f"{len(entries)} entries" if isinstance(entries, list) else "no list"
    findings.error(
        path, "image", "does not match scene_gt.json", place=Place(scene_id, int(key)),
        detail=f"{found} for {count} annotations",
        cause="one of the files is of an older version of the data",
        remedy="compute scene_gt_info.json anew (bop_toolkit: calc_gt_info.py)",
    )  # fmt: skip
    return [None] * count


def _poses(
    entries: Sequence[Any],
    names: tuple[str, str],
    path: Path,
    places: Sequence[Place],
    findings: Findings,
    optional: bool = False,
) -> np.ndarray:
    """Transforms (N, 4, 4) in metres, all NaN where a part is broken."""
    T = np.tile(np.eye(4), (len(entries), 1, 1))
    args = (path, places, findings, optional)
    T[:, :3, :3] = read_numbers(entries, names[0], 9, *args).reshape(-1, 3, 3)
    T[:, :3, 3] = read_numbers(entries, names[1], 3, *args) / MM
    T[np.isnan(T).any(axis=(1, 2))] = np.nan
    return T


def _whole(
    content: Mapping[str, Any], path: Path, scene_id: int, findings: Findings
) -> dict[int, str]:
    """Whole number -> key; complains of keys that are none, and of numbers that are there twice."""
    numbers: dict[int, str] = {}
    for key in content:
        if not key.isdigit():
            findings.error(
                path, "keys", "a key must be a picture's number", place=Place(scene_id),
                detail=f"key {key[:40]!r}", remedy="rename or remove the entry",
            )  # fmt: skip
        elif int(key) in numbers:
            findings.error(
                path, "keys", "a picture is there twice", place=Place(scene_id, int(key)),
                detail=f"keys {numbers[int(key)]!r} and {key!r}",
                remedy="give each picture a number of its own",
            )  # fmt: skip
        else:
            numbers[int(key)] = key
    return numbers
