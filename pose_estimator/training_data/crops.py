"""A dataset packed for training: the crop of every target and all downsampled frames, in two files.

Decoding full frames and masks in each epoch would take longer than the network. A pack holds for
each target (one object in one image) a JPEG crop somewhat wider than its ROI and a PNG of its
visible mask, and for each image a JPEG at the detector's size.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...core.array_files import load_arrays
from ...core.errors import InputError

STORED_SIDE = 192
"""Side of a stored crop in pixels."""

STORED_SCALE = 2.1
"""Side of a stored crop in object diameters: margin for shifts, scales and rotations around 1.4."""

DEPTH_STEP = 1e-4
"""Meters per step of a stored depth crop (uint16)."""


@dataclass(frozen=True, eq=False)
class CropPack:
    """Targets and frames of one dataset, memory-mapped.

    Attributes:
        object_names: the objects, in the order of ``object_index``.
        crops: all encoded crops and masks, uint8 bytes.
        frames: all encoded frames, uint8 bytes.
        spans: (T, 6) begin and end of a target's crop, mask and depth in ``crops``; the depth is
            empty where the dataset has none.
        frame_spans: (F, 2) begin and end in ``frames``.
        object_index: (T,).
        frame_index: (T,).
        scene_id: (F,); frames of one scene show a static world.
        T_cam_obj: (T, 4, 4) meters.
        visibility: (T,) 0 to 1.
        to_stored: (T, 3, 3) affine map from full-frame pixels to the stored crop.
        K: (F, 3, 3).
        T_cam_world: (F, 4, 4).
        frame_to_image: (F, 3, 3) affine map from pixels of the stored frame to the full frame.
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
        return _decode_rgb(self.crops[slice(*self.spans[target, :2])])

    def mask(self, target: int) -> np.ndarray:
        """The stored visible mask of a target, uint8 0 or 255 (192, 192)."""
        return _decode(self.crops[slice(*self.spans[target, 2:4])], cv2.IMREAD_GRAYSCALE)

    def depth(self, target: int) -> np.ndarray | None:
        """The stored depth of a target's crop, background included, float32 (192, 192) meters
        along the camera's z, 0 = unknown; None if the dataset has no depth maps."""
        data = self.crops[slice(*self.spans[target, 4:])]
        return _decode(data, cv2.IMREAD_UNCHANGED) * np.float32(DEPTH_STEP) if len(data) else None

    def frame(self, index: int) -> np.ndarray:
        """A frame at the detector's size, RGB uint8 (240, 320, 3)."""
        return _decode_rgb(self.frames[slice(*self.frame_spans[index])])


class _MappedFile(np.memmap):
    """A memory map that is pickled as its file name."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _MappedFile, (self.filename, self.dtype, "r")


def open_pack(folder: Path, object_names: Sequence[str]) -> CropPack:
    """Opens the files of a packed dataset.

    Raises:
        InputError: if one of them is missing or damaged.
    """
    try:
        pack = CropPack(
            object_names=tuple(object_names),
            crops=_MappedFile(folder / "crops.bin", np.uint8, "r"),
            frames=_MappedFile(folder / "frames.bin", np.uint8, "r"),
            **load_arrays(folder / "index.npz"),
        )
        _check_pack(pack)
        return pack
    except (OSError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder} is damaged ({error}): delete it, and it is made again"
        ) from error


def _check_pack(pack: CropPack) -> None:
    """Raises ValueError where the index is not one of these files."""
    targets, frames, T = len(pack.spans), len(pack.frame_spans), (4, 4)
    shapes = {
        "spans": (targets, 6), "frame_spans": (frames, 2), "object_index": (targets,),
        "frame_index": (targets,), "scene_id": (frames,), "T_cam_obj": (targets, *T),
        "visibility": (targets,), "to_stored": (targets, 3, 3), "K": (frames, 3, 3),
        "T_cam_world": (frames, *T), "frame_to_image": (frames, 3, 3),
    }  # fmt: skip
    for name, shape in shapes.items():
        array = getattr(pack, name)
        if array.shape != shape or array.dtype.kind not in "iuf":
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape}, not {shape}")
    limits = {
        "spans": len(pack.crops) + 1, "frame_spans": len(pack.frames) + 1,
        "object_index": len(pack.object_names), "frame_index": frames,
    }  # fmt: skip
    for name, limit in limits.items():
        array = getattr(pack, name)
        if array.dtype.kind == "f" or array.min() < 0 or array.max() >= limit:
            raise ValueError(f"{name} is not 0 to {limit - 1}")
    for name in ("T_cam_obj", "visibility", "to_stored", "K", "frame_to_image"):
        if not np.isfinite(getattr(pack, name)).all():
            raise ValueError(f"{name} has NaN or infinite numbers")


def encode_image(suffix: str, image: np.ndarray) -> bytes:
    """Encodes an RGB (H, W, 3) or single-channel (H, W) image as JPEG or PNG."""
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    options: Sequence[int] = [cv2.IMWRITE_JPEG_QUALITY, 95] if suffix == ".jpg" else []
    ok, data = cv2.imencode(suffix, image, options)
    if not ok:
        raise InputError(f"OpenCV could not encode a {suffix} of shape {image.shape}")
    return data.tobytes()


def _decode_rgb(data: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(_decode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def _decode(data: np.ndarray, flags: int) -> np.ndarray:
    image = cv2.imdecode(data, flags) if len(data) else None
    if image is None:
        path = getattr(data, "filename", "the packed crops")
        raise InputError(f"{path} is damaged: delete its folder, and it is made again")
    return image
