"""What stands in for ``scene_gt_info.json``, which the test splits of some datasets lack."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.images import read_image
from .boxes import NO_BOX, bounding_box
from .scene import Scene, SceneAnnotations


def measure_masks(scene: Scene) -> SceneAnnotations:
    """The annotations of a scene with what its masks say, where there are any.

    What nothing tells is given as nothing being in the way: a visible fraction of 1, boxes and
    pixel counts of -1. With ``mask_visib`` the visible box and count are exact; with ``mask`` too,
    so is the visible fraction, but for what lies outside of the image.
    """
    count = len(scene.annotations.index)
    visibility = np.ones(count)
    boxes = np.tile(NO_BOX, (2, count, 1)).astype(float)
    pixels = np.full((2, count), -1.0)
    for row in range(count):
        visible = _read(scene.mask_path(row))
        if visible is None:
            continue
        boxes[0, row], pixels[0, row] = bounding_box(visible), visible.sum()
        whole = _read(scene.mask_path(row, "mask"))
        if whole is not None:
            boxes[1, row], pixels[1, row] = bounding_box(whole), whole.sum()
            visibility[row] = min(1.0, float(visible.sum()) / max(1, int(whole.sum())))
    return replace(
        scene.annotations,
        visibility=visibility,
        bbox_visib=boxes[0],
        bbox_obj=boxes[1],
        px_count_visib=pixels[0],
        px_count_all=pixels[1],
    )


def _read(path: Path) -> np.ndarray | None:
    """A mask, or None where the file is missing or broken: who needs it will say so."""
    try:
        return read_image(path, "L") > 0
    except (OSError, ValueError):
        return None
