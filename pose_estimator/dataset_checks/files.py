"""Are there files of a scene that nothing speaks of, or too many, or depth maps too few."""

from __future__ import annotations

from pathlib import Path

from ..bop.fields import Place
from ..bop.scene import RESTORE, Scene, image_folder
from .findings import Findings


def check_files(scene: Scene, findings: Findings) -> None:
    """Compares the folders of a scene with its JSON files, without opening images."""
    images = set(scene.image_id.tolist())
    for image_id in sorted(scene.images.keys() - images):
        findings.warning(
            scene.images[image_id], "file", "an image has no camera",
            place=Place(scene.scene_id, image_id), remedy="add it to scene_camera.json",
            detail="scene_camera.json does not list it, so nothing reads it",
        )  # fmt: skip
    for image_id in sorted(images - scene.depths.keys()) if scene.depths else []:
        findings.warning(
            scene.camera_path, "depth", "a depth map is missing", remedy=RESTORE,
            place=Place(scene.scene_id, image_id),
            detail=f"depth/{image_id:06d}.png is not there, others are",
        )  # fmt: skip
    # Two files with one number: which one is read depends on the folder's order.
    folder = image_folder(scene.folder)
    seen: dict[int, str] = {}
    names = sorted(p.name for p in folder.iterdir()) if folder.is_dir() else []
    for name in names:
        if not Path(name).stem.isdigit():
            continue
        number = int(Path(name).stem)
        if number in seen:
            findings.error(
                folder / name, "file", "two images have one number",
                place=Place(scene.scene_id, number), detail=f"{seen[number]} and {name}",
                cause="images were converted and the old ones left", remedy="remove one of them",
            )  # fmt: skip
        seen[number] = name
