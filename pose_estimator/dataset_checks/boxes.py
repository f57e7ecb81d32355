"""Checks boxes, pixel counts and visible fractions of ``scene_gt_info.json``, and masks."""

from collections.abc import Callable

import numpy as np

from ..bop.boxes import bounding_box
from ..bop.fields import MAX_VISIBLE
from ..bop.scene import RECOMPUTE_INFO, Scene
from .findings import Findings, Severity

SLACK = 3
"""Tolerance in pixels: some tools count the last column of a box, others do not."""

CORNERS = "it holds corners (left, top, right, bottom); BOP has left, top, width, height"
FIX_CORNERS = "write right - left and bottom - top instead of right and bottom"


def check_info(scene: Scene, size: tuple[int, int] | None, findings: Findings) -> None:
    """Checks the consistency of all annotations with each other and the image size (H, W)."""
    rows = scene.annotations
    if not rows.has_info:
        return

    def complain(
        wrong: np.ndarray, severity: Severity, field: str, problem: str, **more: str
    ) -> None:
        values = rows.visibility if field == "visib_fract" else getattr(rows, field)
        add = findings.error if severity == "error" else findings.warning
        for row in np.flatnonzero(wrong).tolist():
            detail = str(np.round(values[row], 3).tolist())
            add(scene.info_path, field, problem, place=scene.place(row), detail=detail, **more)

    with np.errstate(invalid="ignore"):
        fraction = rows.visibility
        off = (fraction < 0) | (fraction > MAX_VISIBLE)
        percent = off & (fraction > 1) & (fraction <= 100)
        complain(
            percent, "error", "visib_fract", "must be 0 to 1", remedy="divide by 100",
            cause="it is in percent",
        )  # fmt: skip
        complain(off & ~percent, "error", "visib_fract", "must be 0 to 1", remedy=RECOMPUTE_INFO)
        share = rows.px_count_visib / np.maximum(rows.px_count_all, 1)
        known = (rows.px_count_all > 0) & (rows.px_count_visib >= 0) & ~off
        complain(
            known & (np.abs(share - fraction) > 0.1), "warning", "visib_fract",
            "differs from px_count_visib / px_count_all", remedy=RECOMPUTE_INFO,
        )  # fmt: skip
        if size is not None:
            _check_box(scene, size, complain)
        visible, amodal = rows.bbox_visib, rows.bbox_obj
        boxed = (visible[:, 2:] > 0).all(axis=1) & (amodal[:, 2:] > 0).all(axis=1)
        outside = (visible[:, :2] < amodal[:, :2] - SLACK).any(axis=1)
        ends = visible[:, :2] + visible[:, 2:] > amodal[:, :2] + amodal[:, 2:] + SLACK
        complain(
            boxed & (outside | ends.any(axis=1)), "warning", "bbox_obj",
            "does not contain bbox_visib", remedy=RECOMPUTE_INFO,
        )  # fmt: skip


def _check_box(scene: Scene, size: tuple[int, int], complain: Callable[..., None]) -> None:
    """Checks that visible boxes lie in the image."""
    height, width = size
    box = scene.annotations.bbox_visib
    left, top, right, bottom = box[:, 0], box[:, 1], box[:, 0] + box[:, 2], box[:, 1] + box[:, 3]
    nothing = (box[:, 2:] <= 0).all(axis=1)
    outside = (left < -1) | (top < -1) | (right > width + 1) | (bottom > height + 1)
    outside &= ~nothing
    corners = (left >= -1) & (top >= -1) & (box[:, 2] > left) & (box[:, 3] > top)
    corners &= (box[:, 2] <= width + 1) & (box[:, 3] <= height + 1)
    problem = "is not inside the image"
    complain(outside & corners, "error", "bbox_visib", problem, cause=CORNERS, remedy=FIX_CORNERS)
    cause = "it was computed for images of another size"
    complain(outside & ~corners, "error", "bbox_visib", problem, cause=cause, remedy=RECOMPUTE_INFO)


def check_mask(
    scene: Scene, row: int, mask: np.ndarray, shape: tuple[int, int], findings: Findings
) -> bool:
    """Compares a visible mask with its image and with its entry of ``scene_gt_info.json``.

    Args:
        scene: the scene.
        row: row of its annotations.
        mask: bool (H, W).
        shape: height and width of the image.
        findings: receives the findings.

    Returns:
        Whether the mask has the image's size and is not empty.
    """
    rows, path, place = scene.annotations, scene.mask_path(row), scene.place(row)
    box, visibility = rows.bbox_visib[row], rows.visibility[row]
    if mask.shape != shape:
        findings.error(
            path, "size", "the mask's size differs from the image's", place=place,
            detail=f"{mask.shape[1]}x{mask.shape[0]} for an image of {shape[1]}x{shape[0]}",
            cause="only images or only masks were scaled or cropped",
            remedy="scale images, masks and cam_K together",
        )  # fmt: skip
        return False
    pixels = int(mask.sum())
    if not pixels:
        if visibility > 0.1:
            findings.error(
                path, "pixels", "the mask is empty", place=place, remedy="render the masks again",
                detail=f"visib_fract is {visibility:.2f}",
            )  # fmt: skip
        return False
    found = np.array(bounding_box(mask))
    ends = np.concatenate([found[:2], found[:2] + found[2:]])
    given = np.concatenate([box[:2], box[:2] + box[2:]])
    if np.abs(given - ends).max() > max(SLACK, 0.03 * max(found[2:])):
        cause, remedy = "masks and boxes are of different versions or scales", RECOMPUTE_INFO
        if np.abs(box - ends).max() <= SLACK:
            cause, remedy = CORNERS, FIX_CORNERS
        findings.error(
            scene.info_path, "bbox_visib", "does not match the mask", place=place,
            detail=f"{box.astype(int).tolist()}, the mask's box is {found.tolist()}",
            cause=cause, remedy=remedy,
        )  # fmt: skip
    elif abs(rows.px_count_visib[row] - pixels) > 0.1 * pixels + 20:
        findings.warning(
            scene.info_path, "px_count_visib", "does not match the mask", place=place,
            detail=f"{rows.px_count_visib[row]:.0f}, the mask has {pixels} pixels",
            remedy=RECOMPUTE_INFO,
        )  # fmt: skip
    return True
