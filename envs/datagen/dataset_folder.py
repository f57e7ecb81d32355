"""The folder of a generated dataset: its manifest, and temporary files of killed runs."""

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...core.errors import InputError
from ...pose_estimator.bop.fields import read_json
from ...pose_estimator.bop.writer import write_json

_TEMPORARY = re.compile(r"\..+\.(\d+)\.tmp")
"""Temporary names of ``files.write_atomically``."""


def check_or_write_manifest(
    path: Path, settings: Mapping[str, Any], more: Mapping[str, Any] | None = None
) -> None:
    """Writes a folder's manifest, or checks that an existing one has the same settings.

    Args:
        path: of the manifest; its folder is created if missing.
        settings: that determine the content of the folder, plain data.
        more: further entries, which may change from run to run.

    Raises:
        InputError: if the folder was made with other settings.
    """
    wanted = json.loads(json.dumps(settings, default=str))  # as read from a file
    if path.exists():
        before = read_json(path, dict).get("settings")
        if not isinstance(before, dict):
            raise InputError(f"{path} has no settings: use another --out, or delete the folder")
        changed = ", ".join(
            f"{k:.40} is {before.get(k)!r:.80} there, {wanted.get(k)!r:.80} here"
            for k in sorted(wanted.keys() | before.keys())
            if before.get(k) != wanted.get(k)
        )
        if changed:
            raise InputError(
                f"{path.parent} was made with other settings: {changed}; use another --out, or "
                "delete the folder"
            )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {"settings": wanted, **(more or {})})


def remove_leftovers(*folders: Path) -> None:
    """Removes temporary files of killed runs from folders (not recursively).

    Files of a running process are left untouched: it is about to rename them.
    """
    for folder in folders:
        for path in folder.iterdir() if folder.is_dir() else ():
            match = _TEMPORARY.fullmatch(path.name)
            if match is not None and not _runs(int(match[1])):
                path.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    """Returns whether another process with this id runs on this machine."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return process != os.getpid()
