"""Functions that damage a valid dataset, and the class of a test case."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from PIL import ExifTags, Image
from scipy.spatial.transform import Rotation

SCENE = "test/000003"


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The content of a JSON file, written back when changed."""
    content = json.loads(path.read_text())
    yield content
    path.write_text(json.dumps(content))


def every_pose(data: Path, change: Callable[[np.ndarray, np.ndarray], tuple[Any, Any]]) -> None:
    """Changes R (3, 3) and t (3,) in millimeters of every annotation."""
    for path in data.glob("test/*/scene_gt.json"):
        with opened(path) as scene:
            for entry in (entry for entries in scene.values() for entry in entries):
                R, t = np.reshape(entry["cam_R_m2c"], (3, 3)), np.array(entry["cam_t_m2c"])
                R, t = change(R, t)
                entry["cam_R_m2c"], entry["cam_t_m2c"] = np.ravel(R).tolist(), list(t)


def every_camera(data: Path, change: Callable[[dict[str, Any]], None]) -> None:
    for path in data.glob("test/*/scene_camera.json"):
        with opened(path) as cameras:
            for entry in cameras.values():
                change(entry)


def every_info(data: Path, change: Callable[[dict[str, Any]], None]) -> None:
    for path in data.glob("test/*/scene_gt_info.json"):
        with opened(path) as scene:
            for entry in (entry for entries in scene.values() for entry in entries):
                change(entry)


def every_image(data: Path, pattern: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for path in data.glob(f"test/*/{pattern}"):
        cv2.imwrite(str(path), change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))


def set_orientation(data: Path, orientation: int) -> None:
    """Tags every photograph as a camera does; its pixels stay as they are."""
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    for path in data.glob("test/*/rgb/*"):
        image = Image.open(path)
        image.load()
        image.save(path, exif=exif)


def every_pair(data: Path, change: Callable[[dict[str, Any]], None]) -> None:
    with opened(data / "two_view_pairs.json") as pairs:
        for pair in pairs:
            change(pair)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip_bit(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def first_pose(name: str, place: int, value: float) -> Callable[[Path], None]:
    def damage(data: Path) -> None:
        with opened(data / SCENE / "scene_gt.json") as scene:
            scene["1"][0][name][place] = value

    return damage


def quaternion(order: list[int]) -> Callable[[Path], None]:
    """Every rotation is rebuilt from its quaternion (x, y, z, w) in another order."""

    def turn(R: np.ndarray, t: np.ndarray) -> tuple[Any, Any]:
        return Rotation.from_quat(Rotation.from_matrix(R).as_quat()[order]).as_matrix(), t

    return lambda data: every_pose(data, turn)


def camera_matrix(change: Callable[..., list[float]]) -> Callable[[Path], None]:
    def damage(data: Path) -> None:
        def rewrite(entry: dict[str, Any]) -> None:
            fx, _, cx, _, fy, cy, *_ = entry["cam_K"]
            entry["cam_K"] = change(fx, fy, cx, cy)

        every_camera(data, rewrite)

    return damage


def set_key(file: str, *keys: Any, value: Any) -> Callable[[Path], None]:
    def damage(data: Path) -> None:
        with opened(data / file) as content:
            for key in keys[:-1]:
                content = content[key]
            content[keys[-1]] = value

    return damage


def rescale(file: str, factor: float) -> Callable[[Path], None]:
    def damage(data: Path) -> None:
        for path in data.glob(file):
            mesh = trimesh.load_mesh(path, process=False)
            mesh.apply_scale(factor)
            path.write_bytes(trimesh.exchange.ply.export_ply(mesh))

    return damage


def duplicate_key(data: Path) -> None:
    path = data / SCENE / "scene_gt.json"
    text = path.read_text()
    path.write_text(text[:-1] + f', "1": {json.dumps(json.loads(text)["1"])}}}')


def annotate_twice(data: Path) -> None:
    for name in ("scene_gt.json", "scene_gt_info.json"):
        with opened(data / SCENE / name) as scene:
            scene["2"].append(scene["2"][0])
    folder = data / SCENE / "mask_visib"
    shutil.copyfile(folder / "000002_000000.png", folder / "000002_000003.png")


def as_corners(entry: dict[str, Any]) -> None:
    left, top, width, height = entry["bbox_visib"]
    entry["bbox_visib"] = [left, top, left + width, top + height]


def shift(image: np.ndarray) -> np.ndarray:
    return np.roll(image, 45, axis=1)


def shift_boxes(entry: dict[str, Any]) -> None:
    entry["bbox_visib"][0] += 45


def shift_masks(data: Path) -> None:
    every_image(data, "mask_visib/*", shift)
    every_info(data, shift_boxes)


def inverted(name: str) -> Callable[[dict[str, Any]], None]:
    """Inverts the transform of an entry, such as ``w2c``."""

    def change(entry: dict[str, Any]) -> None:
        R = np.reshape(entry[f"cam_R_{name}"], (3, 3))
        entry[f"cam_t_{name}"] = (-R.T @ entry[f"cam_t_{name}"]).tolist()
        entry[f"cam_R_{name}"] = R.T.ravel().tolist()

    return change


def scaled(name: str, factor: float) -> Callable[[dict[str, Any]], None]:
    def change(entry: dict[str, Any]) -> None:
        entry[name] = (np.array(entry[name]) * factor).tolist()

    return change


GL = np.diag([1.0, -1.0, -1.0])
MIRROR = np.diag([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class Damage:
    """A change to a valid dataset, and the file, field, words and severity of its finding."""

    do: Callable[[Path], None]
    file: str
    field: str
    words: str
    severity: str = "error"
    count: int | None = None
