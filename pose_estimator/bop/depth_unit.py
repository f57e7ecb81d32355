"""The unit of a single depth map of a dataset."""

from pathlib import Path

from ...core.errors import InputError
from ...core.validation import is_number
from .fields import MAX_VALUE, MM, is_id, read_json


def stored_depth_unit(path: Path) -> float | None:
    """Returns the meters per unit of a depth map by its scene's ``scene_camera.json``.

    Returns:
        None if the file is not in the folder ``depth`` of a scene, or that of another sensor, such
        as ``depth_tof``.

    Raises:
        InputError: if the camera file is malformed.
    """
    folder = path.resolve().parent
    camera = folder.parent / f"scene_camera{folder.name.removeprefix('depth')}.json"
    if not (folder.name.startswith("depth") and is_id(path.stem) and camera.is_file()):
        return None
    entry = read_json(camera, dict).get(str(int(path.stem)))
    scale = entry.get("depth_scale", 1.0) if isinstance(entry, dict) else 1.0
    if not is_number(scale) or not 0 < scale < MAX_VALUE:
        raise InputError(f"{camera}: depth_scale must be positive, got {scale!r:.80}")
    return scale / MM
