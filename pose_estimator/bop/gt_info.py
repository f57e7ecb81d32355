"""Computes what ``scene_gt_info.json`` holds, which the test splits of some datasets lack."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.images import read_mask
from .boxes import NO_BOX, bounding_box
from .scene import Scene, SceneAnnotations


def measure_masks(scene: Scene) -> SceneAnnotations:
    """Returns the annotations of a scene with boxes, pixel counts and visibility from its masks.

    Without masks the visible fraction is 1, boxes and pixel counts are -1. With ``mask_visib`` the
    visible box and count are exact; with ``mask`` too, the visible fraction is that within the
    image.
    """
    count = len(scene.annotations.index)
    visibility = np.ones(count)
    boxes = np.tile(NO_BOX, (2, count, 1)).astype(float)
    pixels = np.full((2, count), -1.0)
    for row in range(count):
        visible = read_binary_mask(scene.mask_path(row))
        if visible is None:
            continue
        boxes[0, row], pixels[0, row] = bounding_box(visible), visible.sum()
        amodal = read_binary_mask(scene.mask_path(row, "mask"))
        if amodal is not None:
            boxes[1, row], pixels[1, row] = bounding_box(amodal), amodal.sum()
            visibility[row] = min(1.0, float(visible.sum()) / max(1, int(amodal.sum())))
    return replace(
        scene.annotations,
        visibility=visibility,
        bbox_visib=boxes[0],
        bbox_obj=boxes[1],
        px_count_visib=pixels[0],
        px_count_all=pixels[1],
    )


def read_binary_mask(path: Path) -> np.ndarray | None:
    """Returns a mask, bool (H, W), or None where the file is missing or broken."""
    try:
        return read_mask(path)
    except (OSError, ValueError):
        return None
