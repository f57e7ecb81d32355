"""COCO annotations of a BOP scene, as bop_toolkit's ``calc_gt_coco.py`` makes them.

Boxes are amodal, segmentations are of the visible pixels, as uncompressed run-length encoding (RLE)
(https://cocodataset.org/#format-data).
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError
from .boxes import bounding_box
from .fields import read_json
from .gt_info import read_binary_mask
from .targets import MIN_VISIBLE_FRACTION
from .writer import write_json

COCO_FILE = "scene_gt_coco.json"


def write_coco(folder: Path, obj_ids: Iterable[int]) -> None:
    """Writes ``scene_gt_coco.json`` of a scene folder with ``mask`` and ``mask_visib``.

    Invisible objects are left out; those with a visible fraction below that of targets are marked
    ``ignore``. The file holds no dates, so the same scene gives the same bytes.

    Args:
        folder: the scene's folder.
        obj_ids: the dataset's objects, which become COCO's categories.

    Raises:
        InputError: if a file of the scene is missing or invalid.
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
                left, top, width, height = bounding_box(_mask(folder / "mask" / name))
                annotations.append(
                    {
                        "id": len(annotations) + 1,
                        "image_id": image_id,
                        "category_id": int(pose["obj_id"]),
                        "iscrowd": 0,
                        "ignore": info["visib_fract"] < MIN_VISIBLE_FRACTION,
                        "area": int(np.count_nonzero(visible)),
                        # COCO counts the columns covered.
                        "bbox": [left, top, width + 1, height + 1],
                        "segmentation": encode_rle(visible),
                        "width": shape[1],
                        "height": shape[0],
                    }
                )
        height, width = _mask(paths[image_id]).shape if shape is None else shape
        image = {"id": image_id, "file_name": f"rgb/{paths[image_id].name}", "license": 1}
        images.append(image | {"width": width, "height": height})
    categories = [
        {"id": obj_id, "name": str(obj_id), "supercategory": "object"} for obj_id in sorted(obj_ids)
    ]
    about = {"description": f"scene {folder.name}", "version": "1"}
    content = {"info": about, "licenses": [], "categories": categories}
    write_json(folder / COCO_FILE, content | {"images": images, "annotations": annotations})


def encode_rle(mask: np.ndarray) -> dict[str, list[int]]:
    """Returns COCO's uncompressed RLE of a mask, bool (H, W).

    Runs are in column-major order; the first counts background pixels and may be 0.
    """
    pixels = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(pixels)) + 1
    counts = np.diff(changes, prepend=0, append=pixels.size).tolist()
    return {"counts": [0, *counts] if pixels[0] else counts, "size": list(mask.shape)}


def _mask(path: Path) -> np.ndarray:
    mask = read_binary_mask(path)
    if mask is None:
        raise InputError(f"{path} is missing or broken: COCO needs all masks")
    return mask
