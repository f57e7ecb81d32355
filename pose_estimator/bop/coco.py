"""COCO annotations of a BOP scene, as bop_toolkit's ``calc_gt_coco.py`` makes them.

The boxes are those of the whole silhouettes, the segmentations those of the visible pixels.
Segmentations are run lengths, not compressed, which every COCO reader takes
(https://cocodataset.org/#format-data).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...core.images import read_image
from .boxes import bounding_box
from .fields import read_json
from .targets import LEAST_VISIBLE
from .writer import write_json

COCO_FILE = "scene_gt_coco.json"


def write_coco(folder: Path, obj_ids: Iterable[int]) -> None:
    """Writes ``scene_gt_coco.json`` of a scene that lies on the disk.

    Objects of which nothing is visible are left out; those of which too little is visible to be
    targets are marked ``ignore``. No dates are written: the same scene gives the same bytes.

    Args:
        folder: the scene's, with ``mask`` and ``mask_visib``.
        obj_ids: the dataset's objects, which become COCO's categories.

    Raises:
        InputError: if a file of the scene is missing or broken.
    """
    poses = read_json(folder / "scene_gt.json", dict)
    infos = read_json(folder / "scene_gt_info.json", dict)
    paths = {int(path.stem): path for path in (folder / "rgb").iterdir()}
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for key in sorted(poses, key=int):
        image_id = int(key)
        shape: tuple[int, ...] | None = None
        for i, (pose, info) in enumerate(zip(poses[key], infos.get(key, ()), strict=True)):
            name = f"{image_id:06d}_{i:06d}.png"
            visible = _mask(folder / "mask_visib" / name)
            shape = visible.shape
            if visible.any():
                whole = _mask(folder / "mask" / name)
                entry = _annotation(visible, whole, ignore=info["visib_fract"] < LEAST_VISIBLE)
                numbers = {"id": len(annotations) + 1, "image_id": image_id}
                annotations.append(numbers | {"category_id": int(pose["obj_id"])} | entry)
        if shape is None:
            shape = _mask(paths[image_id]).shape
        images.append(_image(image_id, f"rgb/{paths[image_id].name}", shape))
    categories = [
        {"id": obj_id, "name": str(obj_id), "supercategory": "object"} for obj_id in sorted(obj_ids)
    ]
    about = {"description": f"scene {folder.name}", "version": "1"}
    content = {"info": about, "licenses": [], "categories": categories}
    write_json(folder / COCO_FILE, content | {"images": images, "annotations": annotations})


def run_lengths(mask: np.ndarray) -> dict[str, list[int]]:
    """COCO's run lengths of a mask, bool (H, W).

    Column after column, pixels that are out and pixels that are in take turns; the first count is
    that of pixels that are out, and may be 0.
    """
    pixels = mask.ravel(order="F")
    turns = np.flatnonzero(np.diff(pixels)) + 1
    counts = np.diff(turns, prepend=0, append=pixels.size).tolist()
    return {"counts": [0, *counts] if pixels[0] else counts, "size": list(mask.shape)}


def _annotation(visible: np.ndarray, whole: np.ndarray, ignore: bool) -> dict[str, Any]:
    left, top, width, height = bounding_box(whole)
    return {
        "iscrowd": 0,
        "ignore": ignore,
        "area": int(np.count_nonzero(visible)),
        "bbox": [left, top, width + 1, height + 1],  # COCO counts the columns that are covered
        "segmentation": run_lengths(visible),
        "width": visible.shape[1],
        "height": visible.shape[0],
    }


def _image(image_id: int, file_name: str, shape: tuple[int, ...]) -> dict[str, Any]:
    size = {"width": shape[1], "height": shape[0]}
    return {"id": image_id, "file_name": file_name, "license": 1, **size}


def _mask(path: Path) -> np.ndarray:
    """A mask's true pixels, bool (H, W)."""
    try:
        return read_image(path, "L") > 0
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is missing or broken: COCO needs all masks") from error
