"""What stands in for ``scene_gt_info.json``, which the test splits of some datasets lack."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .bop_boxes import NO_BOX, bounding_box


def info_from_masks(folder: Path, poses: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Content like that of ``scene_gt_info.json``, measured on the masks where there are any.

    What nothing tells is given as nothing being in the way: a visible fraction of 1, boxes and
    pixel counts of -1. With ``mask_visib`` the visible box and count are exact; with ``mask`` too,
    so is the visible fraction, but for what lies outside of the picture.

    Args:
        folder: the scene.
        poses: content of its ``scene_gt.json``.
    """
    masked = (folder / "mask_visib").is_dir()
    return {
        key: [_describe(folder, int(key), i) if masked else _entry() for i in range(len(entries))]
        for key, entries in poses.items()
        if isinstance(entries, list)
    }


def _entry() -> dict[str, Any]:
    return {
        "bbox_obj": NO_BOX,
        "bbox_visib": NO_BOX,
        "px_count_all": -1,
        "px_count_visib": -1,
        "visib_fract": 1.0,
    }


def _describe(folder: Path, image_id: int, index: int) -> dict[str, Any]:
    entry = _entry()
    name = f"{image_id:06d}_{index:06d}.png"
    visible = _read(folder / "mask_visib" / name)
    if visible is not None:
        entry["bbox_visib"], entry["px_count_visib"] = bounding_box(visible), int(visible.sum())
        whole = _read(folder / "mask" / name)
        if whole is not None:
            entry["bbox_obj"], entry["px_count_all"] = bounding_box(whole), int(whole.sum())
            entry["visib_fract"] = min(1.0, float(visible.sum()) / max(1, int(whole.sum())))
    return entry


def _read(path: Path) -> np.ndarray | None:
    """A mask, or None where the file is missing or broken: who needs it will say so."""
    mask = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.is_file() else None
    return None if mask is None else mask > 0
