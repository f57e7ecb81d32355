"""Readers of camera matrices and relative poses that ``estimate`` takes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from helpers.boxes import orbit
from two_view_pose.core.geometry import LINEMOD_K
from two_view_pose.pose_estimator.bop.writer import write_camera
from two_view_pose.pose_estimator.camera_files import parse_intrinsics, read_relative_pose

from .dataset_readers import check_rigid
from .judge import Reader, require

_T = orbit(20, 50, 0.75)


def _write(values: np.ndarray, key: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        np.save(folder / "a.npy", values)
        np.savez(folder / "b.npz", **{key: values})
        np.savetxt(folder / "c.txt", values)
        np.savetxt(folder / "d.csv", values, delimiter=",")
        (folder / "e.json").write_text(json.dumps({key: values.tolist()}))
        (folder / "f.json").write_text(json.dumps(values.tolist()))
        for name in ("g.yml", "h.xml"):
            storage = cv2.FileStorage(str(folder / name), cv2.FILE_STORAGE_WRITE)
            storage.write(key, values)
            storage.release()

    return write


def _write_intrinsics(folder: Path) -> None:
    _write(LINEMOD_K, "K")(folder)
    write_camera(folder, LINEMOD_K, (480, 640))
    scene = {"0": {"cam_K": LINEMOD_K.ravel().tolist(), "depth_scale": 1.0}}
    (folder / "scene_camera.json").write_text(json.dumps(scene))


def _write_pose(folder: Path) -> None:
    _write(_T, "T_second_reference")(folder)
    parts = {"R": _T[:3, :3].tolist(), "t": _T[:3, 3].tolist()}
    (folder / "i.json").write_text(json.dumps(parts))


def _damage_one(folder: Path, rng: np.random.Generator) -> Path:
    from .damage import damage

    files = sorted(folder.iterdir())
    path = files[int(rng.integers(len(files)))]
    damage(path, rng)
    return path


def _intrinsics(path: Path) -> None:
    camera = parse_intrinsics(str(path))
    K = camera.K
    require(K.shape == (3, 3) and np.isfinite(K).all(), f"K {K.tolist()}")
    require(K[0, 0] > 0 < K[1, 1] and np.allclose(K[2], (0, 0, 1)), f"K {K.tolist()}")
    if camera.size is not None:
        require(min(camera.size) > 0, f"size {camera.size}")  # compared with the photograph


def _pose(path: Path) -> None:
    check_rigid(read_relative_pose(path), "relative pose")


CAMERAS = {
    "intrinsics": Reader(_write_intrinsics, (), _intrinsics, _damage_one),
    "relative-pose": Reader(_write_pose, (), _pose, _damage_one),
}
