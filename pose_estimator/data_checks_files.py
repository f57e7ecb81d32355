"""Is every file there that the others speak of: pictures, masks, depth maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .bop_raw import RawScene
from .data_findings import Findings, Place

RESTORE = "restore the file, or take its entry out of the JSON files"


def check_files(scene: RawScene, findings: Findings) -> None:
    """Compares the folders of a scene with its JSON files, without opening pictures."""
    images = set(scene.image_id.tolist())
    rgb = scene.folder / ("rgb" if (scene.folder / "rgb").is_dir() else "gray")
    for image_id in sorted(images - scene.pictures.keys()):
        findings.error(
            scene.camera_path, "image", "a picture is missing",
            place=Place(scene.scene_id, image_id), remedy=RESTORE,
            detail=f"{rgb.name}/{image_id:06d}.png (or .jpg) is not there",
        )  # fmt: skip
    for image_id in sorted(scene.pictures.keys() - images):
        findings.warning(
            scene.pictures[image_id], "file", "a picture has no camera",
            place=Place(scene.scene_id, image_id), remedy="add it to scene_camera.json",
            detail="scene_camera.json does not list it, so nothing reads it",
        )  # fmt: skip
    annotated = np.unique(scene.annotations.image_id)
    for image_id in sorted(set(annotated.tolist()) - images):
        findings.error(
            scene.gt_path, "image", "an annotated picture has no camera",
            place=Place(scene.scene_id, image_id), detail="scene_camera.json does not list it",
            cause="the JSON files are of different versions, or picture numbers were changed",
            remedy="add it to scene_camera.json",
        )  # fmt: skip
    if scene.depths:
        for image_id in sorted(images - scene.depths.keys()):
            findings.warning(
                scene.camera_path, "depth", "a depth map is missing", remedy=RESTORE,
                place=Place(scene.scene_id, image_id),
                detail=f"depth/{image_id:06d}.png is not there, others are",
            )  # fmt: skip
    _check_twins(rgb, scene, findings)
    _check_masks(scene, findings)


def _check_twins(folder: Path, scene: RawScene, findings: Findings) -> None:
    """Two files with one number: which one is read depends on the folder's order."""
    if not folder.is_dir():
        return
    seen: dict[int, str] = {}
    for name in sorted(p.name for p in folder.iterdir() if p.stem.isdigit()):
        number = int(Path(name).stem)
        if number in seen:
            findings.error(
                folder / name, "file", "two pictures have one number",
                place=Place(scene.scene_id, number), detail=f"{seen[number]} and {name}",
                cause="pictures were converted and the old ones left", remedy="remove one of them",
            )  # fmt: skip
        seen[number] = name


def _check_masks(scene: RawScene, findings: Findings) -> None:
    folder = scene.folder / "mask_visib"
    if not folder.is_dir():
        return
    names = {p.name for p in folder.iterdir()}
    rows = scene.annotations
    for row, (image, index) in enumerate(zip(rows.image_id, rows.index, strict=True)):
        if f"{image:06d}_{index:06d}.png" not in names:
            findings.error(
                scene.gt_path, "mask_visib", "a mask is missing",
                place=rows.place(scene.scene_id, row),
                remedy="restore the file (masks are numbered by picture and annotation), or take "
                "the annotation out of the JSON files",
                detail=f"mask_visib/{image:06d}_{index:06d}.png is not there",
            )  # fmt: skip
