"""Readers of photographs, masks and depth maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import ExifTags, Image
from two_view_pose.core.images import read_image, read_image_size, read_mask, read_photograph
from two_view_pose.pose_estimator.input_files import read_depth_map

from .judge import Reader, require

_SHAPE = (12, 16)


def _pixels(depth: bool = False) -> np.ndarray:
    ramp = np.arange(_SHAPE[0] * _SHAPE[1]).reshape(_SHAPE)
    if depth:
        return (700 + ramp).astype(np.uint16)
    return np.stack([ramp % 256, ramp[::-1] % 256, (3 * ramp) % 256], axis=2).astype(np.uint8)


def _photograph(name: str, **options: object) -> Reader:
    def write(folder: Path) -> None:
        exif = Image.Exif()
        exif[ExifTags.Base.Orientation] = 6
        Image.fromarray(_pixels()).save(folder / name, exif=exif, **options)

    def read(folder: Path) -> None:
        path = folder / name
        height, width = read_image_size(path)
        require(0 < height < 10**6 and 0 < width < 10**6, f"size {height} {width}")
        image = read_image(path)
        require(image.shape == (height, width, 3), f"{image.shape}, size {height} {width}")
        require(image.dtype == np.uint8, f"{image.dtype}")
        upright, orientation = read_photograph(path)
        require(upright.dtype == np.uint8 and upright.ndim == 3, f"{upright.shape}")
        require(1 <= orientation <= 8, f"orientation {orientation}")
        require(sorted(upright.shape) == sorted(image.shape), f"{upright.shape} {image.shape}")
        mask = read_mask(path)
        require(mask.shape == (height, width) and mask.dtype == bool, f"mask {mask.shape}")

    return Reader(write, (name,), read)


def _depth(name: str) -> Reader:
    def write(folder: Path) -> None:
        if name.endswith(".npy"):
            np.save(folder / name, _pixels(depth=True) / np.float32(1000))
        else:
            Image.fromarray(_pixels(depth=True)).save(folder / name)

    def read(folder: Path) -> None:
        depth = read_depth_map(folder / name)
        require(depth.meters.ndim == 2 and depth.meters.dtype == np.float32, "depth map")
        require(np.isfinite(depth.meters) & (depth.meters >= 0), "depth")
        require(0.05 < np.median(depth.meters[depth.meters > 0]) < 30, "median")

    return Reader(write, (name,), read)


IMAGES = {
    "png": _photograph("photo.png"),
    "jpeg": _photograph("photo.jpg", quality=90),
    "tiff": _photograph("photo.tif"),
    "tiff-deflate": _photograph("photo.tif", compression="tiff_deflate"),
    "depth-png": _depth("depth.png"),
    "depth-tiff": _depth("depth.tif"),
    "depth-npy": _depth("depth.npy"),
}
