"""Recognizes scenes in BOP's other layouts, of which only scenewise with one camera is read.

https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
"""

from pathlib import Path
from typing import NamedTuple

_CAMERAS = "scene_camera_"


class OtherLayout(NamedTuple):
    """What a scene's folder holds instead, and what to do."""

    problem: str
    remedy: str


def other_layout(scene: Path) -> OtherLayout | None:
    """Returns in which other layout a scene's folder is; None where it is not known."""
    cameras = sorted(path.stem.removeprefix(_CAMERAS) for path in scene.glob(f"{_CAMERAS}*.json"))
    if not cameras:
        folders = (path.name for path in scene.glob("*_*/") if path.is_dir())
        images = (name.partition("_") for name in folders)
        cameras = sorted({camera for kind, _, camera in images if kind in ("rgb", "gray")})
    if cameras:
        first = cameras[0]
        return OtherLayout(
            f"is of one camera, and the scene has several files of cameras: {', '.join(cameras)}",
            f"copy the files of one camera to the plain names: scene_camera_{first}.json to "
            f"scene_camera.json, scene_gt_{first}.json to scene_gt.json, rgb_{first} to rgb, "
            f"mask_visib_{first} to mask_visib, and so on",
        )
    if next(scene.glob("*.camera.json"), None) is not None:
        return OtherLayout(
            "is of BOP's scenewise format, and the scene is in its imagewise format",
            "download the scenewise files",
        )
    return None


def holds_shards(folder: Path) -> bool:
    """Whether a split's folder holds BOP's webdataset format: archives of images."""
    return next(folder.glob("*.tar"), None) is not None
