"""Packs a BOP dataset for training; see :mod:`.crops` for the format."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from tqdm import tqdm

from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.files import naming, write_atomically
from ...core.geometry import crop_matrix, project
from ...core.image_crop import warp_crop
from ..bop.dataset import (
    BopDataset,
    BopImage,
    read_dataset,
    read_depth,
    read_mask,
    read_rgb,
    require_masks,
)
from ..networks.detector import DetectorConfig, detector_input
from .crops import DEPTH_STEP, STORED_SCALE, STORED_SIDE, CropPack, encode_image, open_pack

_FORMAT = 5

_MIN_VISIBILITY = 0.1
"""Minimum visibility of a packed target."""

_WORKERS = 2
_SCENES_PER_JOB = 8

_Targets = Mapping[int, tuple[int, float]]
"""obj_id -> index and diameter in meters of the packed objects."""


def pack_dataset(
    root: str | Path, objects: Mapping[str, ObjectModel], *, split: str = "train_pbr"
) -> CropPack:
    """Packs a dataset into its own folder, or opens the existing pack.

    It is packed again if the scenes, the size of an annotation file, the objects, or their
    diameters or keypoints changed.

    Args:
        root: the BOP dataset.
        objects: objects to pack, by name; their order defines ``object_index``.
        split: folder of the scenes.

    Raises:
        InputError: if the dataset has no image of any of the objects, or no masks.
    """
    dataset = read_dataset(root, split)
    folder = dataset.root / f"packed_{split}"
    header = {
        "format": _FORMAT,
        "options": [STORED_SIDE, STORED_SCALE, DEPTH_STEP, _MIN_VISIBILITY],
        "scenes": _scenes_digest(dataset),
        "models": {name: _fingerprint(model) for name, model in objects.items()},
        "objects": list(objects),
    }
    if not _is_packed(folder, header):
        require_masks(dataset)
        (folder / "header.json").unlink(missing_ok=True)
        _pack(dataset, folder, objects)
        write_atomically(folder / "header.json", json.dumps(header).encode())
    return open_pack(folder, list(objects))


def _scenes_digest(dataset: BopDataset) -> str:
    """Hashes the scene numbers and the sizes of their annotation files."""
    digest = hashlib.sha256()
    for scene_id in dataset.scene_ids:
        scene = dataset.root / dataset.split / f"{scene_id:06d}"
        for name in ("scene_camera.json", "scene_gt.json", "scene_gt_info.json"):
            path = scene / name
            size = path.stat().st_size if path.is_file() else None
            digest.update(f"{scene_id} {name} {size}\n".encode())
    return digest.hexdigest()


def _fingerprint(model: ObjectModel) -> dict[str, Any]:
    """What crops and labels depend on, to detect a changed model."""
    micrometers = np.round(model.keypoints * 1e6).astype("<i8")
    return {
        "obj_id": model.obj_id,
        "diameter": round(model.diameter, 6),
        "keypoints": hashlib.sha256(micrometers.tobytes()).hexdigest(),
    }


def _is_packed(folder: Path, header: dict[str, Any]) -> bool:
    try:
        return json.loads((folder / "header.json").read_text()) == header
    except (OSError, RecursionError, ValueError):
        return False


def _pack(dataset: BopDataset, folder: Path, objects: Mapping[str, ObjectModel]) -> None:
    """Writes the files of a pack."""
    folder.mkdir(parents=True, exist_ok=True)
    rows: dict[str, list[Any]] = {}
    crop_end = frame_end = 0
    with (
        naming(folder),
        open(folder / "crops.bin", "wb") as crop_file,
        open(folder / "frames.bin", "wb") as frame_file,
    ):
        for number, frame in enumerate(_packed_frames(dataset, objects)):
            jpeg = frame.pop("jpeg")
            frame_file.write(jpeg)
            frame["frame_spans"] = (frame_end, frame_end + len(jpeg))
            frame_end += len(jpeg)
            for target in frame.pop("targets"):
                ends = [crop_end]
                for part in ("jpeg", "png", "depth"):
                    data = target.pop(part)
                    crop_file.write(data)
                    ends.append(ends[-1] + len(data))
                crop_end = ends[-1]
                _append(rows, target | {"spans": np.repeat(ends, 2)[1:-1], "frame_index": number})
            _append(rows, frame)
    if "spans" not in rows:
        raise InputError(
            f"{dataset.root} ({dataset.split}) shows none of the objects {', '.join(objects)}"
        )
    temporary = folder / "index.tmp.npz"
    columns: dict[str, Any] = {name: np.asarray(values) for name, values in rows.items()}
    with naming(temporary):
        np.savez(temporary, **columns)
    os.replace(temporary, folder / "index.npz")


def _append(rows: dict[str, list[Any]], values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        rows.setdefault(name, []).append(value)


def _packed_frames(
    dataset: BopDataset, objects: Mapping[str, ObjectModel]
) -> Iterator[dict[str, Any]]:
    """Yields the packed images of a dataset in order."""
    targets = {m.obj_id: (index, m.diameter) for index, m in enumerate(objects.values())}
    pack = partial(_pack_scenes, dataset, targets)
    ids = dataset.scene_ids
    jobs = [ids[i : i + _SCENES_PER_JOB] for i in range(0, len(ids), _SCENES_PER_JOB)]
    with (
        tqdm(total=len(ids), desc="packing", unit="scene", mininterval=2.0) as bar,
        ProcessPoolExecutor(
            _WORKERS, get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
        ) as pool,
    ):
        # The pool starts no process for a single job.
        packed = map(pack, jobs) if len(jobs) == 1 else pool.map(pack, jobs)
        for scene_ids, frames in zip(jobs, packed, strict=True):
            yield from frames
            bar.update(len(scene_ids))


def _pack_scenes(
    dataset: BopDataset, targets: _Targets, scene_ids: tuple[int, ...]
) -> list[dict[str, Any]]:
    return [
        _pack_image(image, targets)
        for scene_id in scene_ids
        for image in dataset.scene(scene_id).values()
    ]


def _pack_image(image: BopImage, targets: _Targets) -> dict[str, Any]:
    """Encodes an image at the detector's size, its cameras, and the crops of its targets."""
    rgb = read_rgb(image)
    small, to_image = detector_input(rgb, DetectorConfig())
    depth = read_depth(image) if image.depth_path is not None else None
    packed = []
    for annotation in image.annotations:
        if annotation.obj_id not in targets or annotation.visibility < _MIN_VISIBILITY:
            continue
        index, diameter = targets[annotation.obj_id]
        T = annotation.T_cam_obj
        side = STORED_SCALE * diameter * image.K[0, 0] / T[2, 3]
        affine = crop_matrix(project(T[:3, 3], image.K), side, STORED_SIDE)
        mask = read_mask(annotation).astype(np.uint8) * 255
        packed.append(
            {
                "jpeg": encode_image(".jpg", warp_crop(rgb, affine, STORED_SIDE)),
                "png": encode_image(".png", warp_crop(mask, affine, STORED_SIDE)),
                "depth": b"" if depth is None else encode_image(".png", depth_crop(depth, affine)),
                "object_index": index,
                "T_cam_obj": T,
                "visibility": annotation.visibility,
                "to_stored": affine,
            }
        )
    return {
        "jpeg": encode_image(".jpg", small),
        "scene_id": image.scene_id,
        "K": image.K,
        "T_cam_world": np.eye(4) if image.T_cam_world is None else image.T_cam_world,
        "frame_to_image": to_image,
        "targets": packed,
    }


def depth_crop(depth: np.ndarray, affine: np.ndarray) -> np.ndarray:
    """Cuts a crop of a depth map (H, W) in meters by nearest-neighbor sampling.

    Returns:
        (192, 192) uint16 in steps of ``DEPTH_STEP``, 0 = unknown.
    """
    steps = np.clip(depth / DEPTH_STEP, 0, 65535).round().astype(np.uint16)
    size = (STORED_SIDE, STORED_SIDE)
    return cv2.warpAffine(steps, affine[:2], size, flags=cv2.INTER_NEAREST)
