"""Packs a BOP dataset for training: every target's crop and every small frame, in two files.

Decoding full frames and masks again in each epoch would cost more than the network. A pack holds,
for each target (one object in one picture), a JPEG crop somewhat wider than its region of interest
and a PNG of its visible mask, and for each picture a JPEG at the detector's size.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from tqdm import tqdm

from ..assets.object_model import ObjectModel
from .bop import BopImage, read_dataset, read_depth, read_mask, read_rgb
from .detector import DetectorConfig, detector_input
from .geometry import crop_matrix, project

STORED_SIDE = 192
"""Side of a stored crop in pixels."""

STORED_SCALE = 2.1
"""Side of a stored crop in object diameters: room for shifts, scales and turns around 1.4."""

DEPTH_STEP = 1e-4
"""Metres for each step of a stored depth crop (uint16)."""

_FORMAT = 4


@dataclass(frozen=True, eq=False)
class CropPack:
    """Targets and frames of one dataset, memory-mapped.

    Attributes:
        object_names: the objects, in the order of ``object_index``.
        crops: all encoded crops and masks, uint8 bytes.
        frames: all encoded small frames, uint8 bytes.
        spans: (T, 6) begin and end of a target's crop, of its mask and of its depth in ``crops``;
            a depth of no bytes where the dataset has none.
        frame_spans: (F, 2) begin and end in ``frames``.
        object_index: (T,) which object.
        frame_index: (T,) which frame.
        scene_id: (F,) the scene of each frame; frames of one scene share a static world.
        T_cam_obj: (T, 4, 4) metres.
        visibility: (T,) 0 to 1.
        to_stored: (T, 3, 3) affine map from full-frame pixels to the stored crop.
        K: (F, 3, 3).
        T_cam_world: (F, 4, 4).
        frame_to_image: (F, 3, 3) affine map from pixels of the small frame to the full frame.
    """

    object_names: tuple[str, ...]
    crops: np.ndarray
    frames: np.ndarray
    spans: np.ndarray
    frame_spans: np.ndarray
    object_index: np.ndarray
    frame_index: np.ndarray
    scene_id: np.ndarray
    T_cam_obj: np.ndarray
    visibility: np.ndarray
    to_stored: np.ndarray
    K: np.ndarray
    T_cam_world: np.ndarray
    frame_to_image: np.ndarray

    def crop(self, target: int) -> np.ndarray:
        """The stored crop of a target, RGB uint8 (192, 192, 3)."""
        begin, end = self.spans[target, :2]
        bgr = _decode(self.crops[begin:end], cv2.IMREAD_COLOR)
        return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)

    def mask(self, target: int) -> np.ndarray:
        """The stored visible mask of a target, uint8 0 or 255 (192, 192)."""
        begin, end = self.spans[target, 2:4]
        return _decode(self.crops[begin:end], cv2.IMREAD_GRAYSCALE)

    def depth(self, target: int) -> np.ndarray | None:
        """The stored depth of a target's whole crop, float32 (192, 192) metres along the camera's
        z, 0 = unknown; None where the dataset has no depth maps."""
        begin, end = self.spans[target, 4:]
        if begin == end:
            return None
        return _decode(self.crops[begin:end], cv2.IMREAD_UNCHANGED) * np.float32(DEPTH_STEP)

    def frame(self, index: int) -> np.ndarray:
        """A frame at the detector's size, RGB uint8 (240, 320, 3)."""
        begin, end = self.frame_spans[index]
        bgr = _decode(self.frames[begin:end], cv2.IMREAD_COLOR)
        return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


class _MappedFile(np.memmap):
    """The bytes of a file, which another process opens itself instead of being sent them."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _MappedFile, (self.filename, self.dtype, "r")


def _decode(data: np.ndarray, flags: int) -> np.ndarray:
    picture = cv2.imdecode(data, flags)
    if picture is None:
        raise ValueError("the packed crops are damaged: delete their folder to pack them anew")
    return picture


def pack_dataset(
    root: str | Path,
    objects: Mapping[str, ObjectModel],
    *,
    split: str = "train_pbr",
    minimum_visibility: float = 0.1,
    workers: int = 2,
) -> CropPack:
    """Packs a dataset beside itself, or opens the pack that is there.

    It is packed anew if the number of scenes, the objects, or their sizes or keypoints changed.

    Args:
        root: the BOP dataset.
        objects: what to pack, by name; the order becomes ``object_index``.
        split: folder of the scenes.
        minimum_visibility: targets that are less visible are left out.
        workers: processes.

    Raises:
        ValueError: if the dataset has no picture of any of the objects.
    """
    root = Path(root)
    folder = root / f"packed_{split}"
    header = {
        "format": _FORMAT,
        "objects": list(objects),
        "minimum_visibility": minimum_visibility,
        "scenes": len(read_dataset(root, split).scene_ids),
        "models": {name: _fingerprint(model) for name, model in objects.items()},
    }
    if not _is_packed(folder, header):
        _pack(root, split, folder, objects, minimum_visibility, workers)
        temporary = folder / "header.json.tmp"
        temporary.write_text(json.dumps(header))
        os.replace(temporary, folder / "header.json")
    with np.load(folder / "index.npz") as index:
        arrays = {name: index[name] for name in index.files}
    return CropPack(
        object_names=tuple(objects),
        crops=_MappedFile(folder / "crops.bin", np.uint8, "r"),
        frames=_MappedFile(folder / "frames.bin", np.uint8, "r"),
        **arrays,
    )


def _fingerprint(model: ObjectModel) -> dict[str, Any]:
    """What crops and labels take from a model, so that another model is told from it."""
    micrometres = np.round(model.keypoints * 1e6).astype("<i8")
    return {
        "obj_id": model.obj_id,
        "diameter": round(model.diameter, 6),
        "keypoints": hashlib.sha256(micrometres.tobytes()).hexdigest(),
    }


def _is_packed(folder: Path, header: dict) -> bool:
    try:
        return json.loads((folder / "header.json").read_text()) == header
    except (OSError, ValueError):
        return False


@dataclass(frozen=True)
class _Job:
    root: Path
    split: str
    scene_ids: tuple[int, ...]
    numbers: dict[int, int]
    diameters: dict[int, float]
    minimum_visibility: float


def _pack(
    root: Path,
    split: str,
    folder: Path,
    objects: Mapping[str, ObjectModel],
    minimum_visibility: float,
    workers: int,
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "header.json").unlink(missing_ok=True)
    numbers = {model.obj_id: index for index, model in enumerate(objects.values())}
    diameters = {model.obj_id: model.diameter for model in objects.values()}
    scene_ids = read_dataset(root, split).scene_ids
    jobs = [
        _Job(root, split, scene_ids[i : i + 8], numbers, diameters, minimum_visibility)
        for i in range(0, len(scene_ids), 8)
    ]
    rows: dict[str, list] = {}
    crop_end = frame_end = frames = 0
    with (
        open(folder / "crops.bin", "wb") as crop_file,
        open(folder / "frames.bin", "wb") as frame_file,
        ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool,
        tqdm(total=len(scene_ids), desc="packing", unit="scene", mininterval=2.0) as bar,
    ):
        for job, result in zip(jobs, pool.map(_pack_scenes, jobs), strict=True):
            for frame in result:
                frame_file.write(frame["jpeg"])
                _append(rows, "frame_spans", (frame_end, frame_end + len(frame["jpeg"])))
                frame_end += len(frame["jpeg"])
                for name in ("scene_id", "K", "T_cam_world", "frame_to_image"):
                    _append(rows, name, frame[name])
                for target in frame["targets"]:
                    ends = [crop_end]
                    for part in ("jpeg", "png", "depth"):
                        crop_file.write(target[part])
                        ends.append(ends[-1] + len(target[part]))
                    _append(rows, "spans", np.repeat(ends, 2)[1:-1])
                    crop_end = ends[-1]
                    _append(rows, "frame_index", frames)
                    for name in ("object_index", "T_cam_obj", "visibility", "to_stored"):
                        _append(rows, name, target[name])
                frames += 1
            bar.update(len(job.scene_ids))
    if "spans" not in rows:
        raise ValueError(f"{root} ({split}) shows none of the objects {', '.join(objects)}")
    temporary = folder / "index.tmp.npz"
    columns: dict[str, Any] = {name: np.asarray(values) for name, values in rows.items()}
    np.savez(temporary, **columns)
    os.replace(temporary, folder / "index.npz")


def _append(rows: dict[str, list], name: str, value: object) -> None:
    rows.setdefault(name, []).append(value)


def _pack_scenes(job: _Job) -> list[dict]:
    cv2.setNumThreads(1)
    dataset = read_dataset(job.root, job.split)
    return [
        _pack_image(image, job)
        for scene_id in job.scene_ids
        for image in dataset.scene(scene_id).values()
    ]


def _pack_image(image: BopImage, job: _Job) -> dict:
    rgb = read_rgb(image)
    small, to_image = detector_input(rgb, DetectorConfig())
    depth = read_depth(image) if image.depth_path is not None else None
    targets = []
    for annotation in image.annotations:
        if annotation.obj_id not in job.numbers or annotation.visibility < job.minimum_visibility:
            continue
        T = annotation.T_cam_obj
        side = STORED_SCALE * job.diameters[annotation.obj_id] * image.K[0, 0] / T[2, 3]
        affine = crop_matrix(project(T[:3, 3], image.K), side, STORED_SIDE)
        mask = read_mask(annotation).astype(np.uint8) * 255
        targets.append(
            {
                "jpeg": _encode(".jpg", warp_crop(rgb, affine, STORED_SIDE)),
                "png": _encode(".png", warp_crop(mask, affine, STORED_SIDE)),
                "depth": b"" if depth is None else _encode(".png", depth_crop(depth, affine)),
                "object_index": job.numbers[annotation.obj_id],
                "T_cam_obj": T,
                "visibility": annotation.visibility,
                "to_stored": affine,
            }
        )
    return {
        "jpeg": _encode(".jpg", small),
        "scene_id": image.scene_id,
        "K": image.K,
        "T_cam_world": np.eye(4) if image.T_cam_world is None else image.T_cam_world,
        "frame_to_image": to_image,
        "targets": targets,
    }


def depth_crop(depth: np.ndarray, affine: np.ndarray) -> np.ndarray:
    """Cuts a depth map (H, W) in metres like :func:`warp_crop`, without mixing depths.

    Returns:
        (192, 192) uint16 in steps of ``DEPTH_STEP``, 0 = unknown.
    """
    steps = np.clip(depth / DEPTH_STEP, 0, 65535).round().astype(np.uint16)
    size = (STORED_SIDE, STORED_SIDE)
    return cv2.warpAffine(steps, affine[:2], size, flags=cv2.INTER_NEAREST)


def _encode(kind: str, picture: np.ndarray) -> bytes:
    if picture.ndim == 3:
        picture = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    options: Sequence[int] = [cv2.IMWRITE_JPEG_QUALITY, 95] if kind == ".jpg" else []
    ok, data = cv2.imencode(kind, picture, options)
    if not ok:
        raise ValueError(f"OpenCV could not encode a {kind} of shape {picture.shape}")
    return data.tobytes()


def warp_crop(picture: np.ndarray, affine: np.ndarray, side: int) -> np.ndarray:
    """Cuts a crop by an affine map, averaging where it shrinks.

    Args:
        picture: (H, W) or (H, W, 3) uint8.
        affine: (3, 3) from pixels of the picture to pixels of the crop.
        side: side of the crop.

    Returns:
        (side, side) or (side, side, 3) uint8; grey (127) or 0 in masks outside the picture.
    """
    shrink = 1.0 / np.sqrt(abs(np.linalg.det(affine[:2, :2])))
    matrix = affine[:2]
    if shrink > 1.5:
        # Bilinear sampling alone would alias: halve the region first.
        factor = 1.0 / round(shrink)
        corners = np.linalg.inv(affine) @ np.array(
            [[0, side, 0, side], [0, 0, side, side], [1, 1, 1, 1.0]]
        )
        low = np.clip(np.floor(corners[:2].min(1)) - 2, 0, None).astype(int)
        high = np.ceil(corners[:2].max(1)).astype(int) + 3
        region = picture[low[1] : max(high[1], low[1] + 1), low[0] : max(high[0], low[0] + 1)]
        if region.size:
            width = max(1, round(region.shape[1] * factor))
            height = max(1, round(region.shape[0] * factor))
            fx, fy = width / region.shape[1], height / region.shape[0]
            picture = cv2.resize(region, (width, height), interpolation=cv2.INTER_AREA)
            back = np.array(
                [
                    [1 / fx, 0, (1 / fx - 1) / 2 + low[0]],
                    [0, 1 / fy, (1 / fy - 1) / 2 + low[1]],
                    [0, 0, 1.0],
                ]
            )
            matrix = (affine @ back)[:2]
    border = (127, 127, 127) if picture.ndim == 3 else 0
    return cv2.warpAffine(
        picture,
        matrix,
        (side, side),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=border,
    )
