"""Checks for unlisted and duplicated images and missing depth maps of a scene."""

from ..bop.fields import Place, is_id
from ..bop.scene import RESTORE, Scene, image_folder
from .findings import Findings


def check_files(scene: Scene, findings: Findings) -> None:
    """Compares the folders of a scene with its JSON files, without opening images."""
    images = set(scene.image_id.tolist())
    for image_id in sorted(scene.images.keys() - images):
        findings.warning(
            scene.images[image_id], "file", "an image has no camera",
            place=Place(scene.scene_id, image_id), remedy="add it to scene_camera.json",
            detail="scene_camera.json does not list it, so it is ignored",
        )  # fmt: skip
    for image_id in sorted(images - scene.depths.keys()) if scene.depths else []:
        findings.warning(
            scene.camera_path, "depth", "a depth map is missing", remedy=RESTORE,
            place=Place(scene.scene_id, image_id),
            detail=f"no file depth/{image_id:06d}.png",
        )  # fmt: skip
    # Of two files with one id, the order of the folder decides which is read.
    folder = image_folder(scene.folder)
    seen: dict[int, str] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if not is_id(path.stem):
            continue
        number = int(path.stem)
        if number in seen:
            findings.error(
                path, "file", "two images have the same id",
                place=Place(scene.scene_id, number), detail=f"{seen[number]} and {path.name}",
                cause="images were converted and the old ones kept", remedy="remove one of them",
            )  # fmt: skip
        seen[number] = path.name
