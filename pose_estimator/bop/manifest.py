"""Reads ``manifest.json`` of a generated dataset: how it was made."""

from pathlib import Path
from typing import Any

from .fields import read_json, refuse

MANIFEST_FILE = "manifest.json"


def read_manifest(root: str | Path) -> dict[str, Any] | None:
    """Returns a dataset's manifest; None where it has none, as datasets of others.

    Raises:
        InputError: if it is not JSON, or its ``settings`` are not those of ``generate``.
    """
    path = Path(root) / MANIFEST_FILE
    if not path.is_file():
        return None
    content = read_json(path, dict)
    settings = content.get("settings", {})
    if not isinstance(settings, dict):
        refuse(path, "settings", "must map names to values", detail=str(settings)[:60])
    objects = settings.get("objects")
    listed = isinstance(objects, list) and all(isinstance(name, str) for name in objects)
    if objects is not None and not listed:
        refuse(path, "objects", "must be a list of names", detail=str(objects)[:60])
    return content
