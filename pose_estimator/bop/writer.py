"""Writes BOP datasets: scenes, camera, pairs.

Files and scene folders are written under a temporary name and renamed, so that an interrupted run
leaves no incomplete ones.
"""

import json
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...core.errors import InputError
from ...core.files import naming, write_atomically
from ...core.geometry import check_image, check_intrinsics, check_rigid
from .dataset import BopAnnotation
from .fields import MM
from .pairs import BopPair

DEPTH_SCALE = 0.1
"""Millimeters per unit of the 16-bit depth maps that we write: up to 6.5 m."""

_BILEVEL = (cv2.IMWRITE_PNG_BILEVEL, 1, cv2.IMWRITE_PNG_COMPRESSION, 1)
"""One bit per pixel: a tenth of the time, a quarter of the bytes; decoders return 0 and 255."""


@dataclass(frozen=True, eq=False)
class BopFrame:
    """One image to write.

    Attributes:
        rgb: RGB uint8, (H, W, 3).
        K: camera matrix in pixels, (3, 3).
        T_cam_world: world to camera, (4, 4), meters, or None.
        annotations: the objects; ``mask_visib_path`` is ignored.
        masks: bool (H, W) masks of the visible pixels, one per annotation, or None.
        depth: meters, float (H, W), 0 where unknown; or None.
        image_id: its id in the scene; None for its position among the frames.
        silhouettes: bool (H, W) amodal masks, one per annotation, or None.
        px_counts_valid: pixels of each silhouette that have depth; None for all of them.
    """

    rgb: np.ndarray
    K: np.ndarray
    T_cam_world: np.ndarray | None
    annotations: Sequence[BopAnnotation]
    masks: Sequence[np.ndarray] | None = None
    depth: np.ndarray | None = None
    image_id: int | None = None
    silhouettes: Sequence[np.ndarray] | None = None
    px_counts_valid: Sequence[int] | None = None


def scene_folder(root: str | Path, split: str, scene_id: int) -> Path:
    """Returns the folder of a scene: ``root/split/000012``."""
    return Path(root) / split / f"{scene_id:06d}"


def write_scene(
    root: str | Path,
    split: str,
    scene_id: int,
    frames: Iterable[BopFrame],
    jpeg_quality: int | None = 92,
) -> Path:
    """Writes one scene and returns its folder.

    Args:
        root: the dataset's folder, created where missing.
        split: such as ``train_pbr``.
        scene_id: the scene's id.
        frames: the images.
        jpeg_quality: quality of JPEG images, or None for PNG.

    Raises:
        InputError: if the scene exists, two frames share an image id, or a frame has NaN, a wrong
            shape, or masks that do not match its annotations.
    """
    final = scene_folder(root, split, scene_id)
    if final.exists():
        raise InputError(f"scene {scene_id} exists already: {final}")
    partial = final.with_name(f".{final.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    (partial / "rgb").mkdir(parents=True)
    with naming(final):
        _write_frames(partial, scene_id, frames, jpeg_quality)
    partial.rename(final)
    return final


def _write_frames(
    partial: Path, scene_id: int, frames: Iterable[BopFrame], jpeg_quality: int | None
) -> None:
    cameras, poses, infos = {}, {}, {}
    for place, frame in enumerate(frames):
        image_id = place if frame.image_id is None else frame.image_id
        name = f"scene {scene_id}, image {image_id}"
        if str(image_id) in cameras:
            raise InputError(f"{name} is duplicated")
        _write_pixels(partial, image_id, frame, jpeg_quality, name)
        cameras[str(image_id)] = _camera_entry(frame, name)
        poses[str(image_id)] = [_pose_entry(a, name) for a in frame.annotations]
        infos[str(image_id)] = _info_entries(frame)
    write_json(partial / "scene_camera.json", cameras)
    write_json(partial / "scene_gt.json", poses)
    write_json(partial / "scene_gt_info.json", infos)


def write_camera(root: str | Path, K: np.ndarray, image_size: tuple[int, int]) -> None:
    """Writes ``camera.json``: the images' common camera; ``image_size`` is (H, W)."""
    K = check_intrinsics(K)
    names = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    height, width = image_size
    camera = {"width": width, "height": height, "depth_scale": DEPTH_SCALE}
    write_json(Path(root) / "camera.json", {k: float(v) for k, v in names.items()} | camera)


def write_pairs(path: str | Path, pairs: Iterable[BopPair]) -> None:
    """Writes two-view pairs as a JSON list.

    Each entry: ``scene_id``, ``ref_image_id``, ``second_image_id``, ``target_obj_id``, ``gap``
    (optional), ``baseline_deg`` (at the target), ``baselines_deg`` (obj_id -> degrees),
    ``visib_fracts`` (obj_id -> visible fractions in the reference and the second view; optional),
    ``cam_R_ref2second`` (9 numbers, row-major), ``cam_t_ref2second`` (millimeters). See `BopPair`.
    """
    entries = []
    for pair in pairs:
        T = check_rigid(pair.T_second_ref, f"T_second_ref of scene {pair.scene_id}")
        entry: dict[str, Any] = {
            "scene_id": pair.scene_id,
            "ref_image_id": pair.ref_image_id,
            "second_image_id": pair.second_image_id,
            "target_obj_id": pair.target_obj_id,
        }
        if pair.gap is not None:
            entry["gap"] = int(pair.gap)
        entry["baseline_deg"] = pair.baseline_deg
        entry["baselines_deg"] = {str(k): float(v) for k, v in pair.baselines_deg.items()}
        if pair.visib_fracts:
            entry["visib_fracts"] = {str(k): [*map(float, v)] for k, v in pair.visib_fracts.items()}
        entries.append(entry | _transform(T, "ref2second"))
    write_json(Path(path), entries)


def _transform(T: np.ndarray, name: str) -> dict[str, list[float]]:
    """Returns BOP's two fields of a transform (4, 4): row-major rotation, and millimeters."""
    rotation, translation = T[:3, :3].ravel().tolist(), (T[:3, 3] * MM).tolist()
    return {f"cam_R_{name}": rotation, f"cam_t_{name}": translation}


def write_json(path: Path, content: Any) -> None:
    """Writes compact JSON atomically.

    Raises:
        InputError: if a number is NaN or infinite.
    """
    try:
        text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    except ValueError as error:
        raise InputError(f"{path} cannot hold NaN or infinite numbers") from error
    write_atomically(path, text.encode())


def _write_pixels(
    folder: Path, image_id: int, frame: BopFrame, jpeg_quality: int | None, name: str
) -> None:
    rgb = check_image(frame.rgb, f"rgb of {name}")
    shape = rgb.shape[:2]
    suffix = "png" if jpeg_quality is None else "jpg"
    options = () if jpeg_quality is None else (cv2.IMWRITE_JPEG_QUALITY, jpeg_quality)
    path = folder / "rgb" / f"{image_id:06d}.{suffix}"
    path.write_bytes(encode_image(path, rgb[..., ::-1], options))
    if frame.depth is not None:
        if frame.depth.shape != shape or not np.isfinite(frame.depth).all():
            raise InputError(f"depth of {name} must be finite and of shape {shape}")
        (folder / "depth").mkdir(exist_ok=True)
        steps = np.maximum(np.round(frame.depth * (MM / DEPTH_SCALE)), 0)
        steps = np.where(steps < 65536, steps, 0).astype(np.uint16)  # farther is unknown
        path = folder / "depth" / f"{image_id:06d}.png"
        path.write_bytes(encode_image(path, steps))
    count = len(frame.annotations)
    for kind, masks in (("mask_visib", frame.masks), ("mask", frame.silhouettes)):
        if masks is None:
            continue
        if len(masks) != count or any(mask.shape != shape for mask in masks):
            raise InputError(
                f"masks of {name} must be {count} (one per annotation) of shape {shape}, "
                f"got {[mask.shape for mask in masks]}"
            )
        (folder / kind).mkdir(exist_ok=True)
        for i, mask in enumerate(masks):
            path = folder / kind / f"{image_id:06d}_{i:06d}.png"
            path.write_bytes(encode_image(path, mask.astype(np.uint8) * 255, _BILEVEL))


def _camera_entry(frame: BopFrame, name: str) -> dict[str, Any]:
    entry: dict[str, Any] = {"cam_K": check_intrinsics(frame.K, f"K of {name}").ravel().tolist()}
    if frame.T_cam_world is not None:
        T = check_rigid(frame.T_cam_world, f"T_cam_world of {name}")
        entry |= _transform(T, "w2c")
    return entry | {"depth_scale": DEPTH_SCALE}


def _pose_entry(annotation: BopAnnotation, name: str) -> dict[str, Any]:
    T = check_rigid(annotation.T_cam_obj, f"T_cam_obj of object {annotation.obj_id} in {name}")
    return _transform(T, "m2c") | {"obj_id": int(annotation.obj_id)}


def _info_entries(frame: BopFrame) -> list[dict[str, Any]]:
    valid = frame.px_counts_valid
    if valid is None:
        valid = [annotation.px_count_all for annotation in frame.annotations]
    return [
        {
            "bbox_obj": [*map(int, annotation.bbox_obj)],
            "bbox_visib": [*map(int, annotation.bbox_visib)],
            "px_count_all": int(annotation.px_count_all),
            "px_count_valid": int(count),
            "px_count_visib": int(annotation.px_count_visib),
            "visib_fract": float(annotation.visibility),
        }
        for annotation, count in zip(frame.annotations, valid, strict=True)
    ]


def encode_image(path: Path, image: np.ndarray, options: Sequence[int] = ()) -> bytes:
    """Returns a BGR or gray image encoded in the format of the path's suffix.

    Raises:
        InputError: if OpenCV cannot encode it.
    """
    done, data = cv2.imencode(path.suffix, np.ascontiguousarray(image), list(options))
    if not done:
        raise InputError(f"cannot encode {path} from {image.dtype} of shape {image.shape}")
    return data.tobytes()
