"""The folder of a generated dataset: whose it is, and what killed runs left in it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...core.errors import InputError
from ...pose_estimator.bop.writer import write_json

_TEMPORARY = re.compile(r"\..+\.(\d+)\.tmp")
"""The names under which files are written, see ``results.write_atomically``."""


def check_or_write_manifest(
    path: Path, settings: Mapping[str, Any], more: Mapping[str, Any] | None = None
) -> None:
    """Writes a folder's manifest, or checks that the one that is there has the same settings.

    Args:
        path: of the manifest; its folder is made where missing.
        settings: what fixes the content of the folder, plain data.
        more: what the manifest says besides, which may change from run to run.

    Raises:
        InputError: if the folder holds something that was made with other settings.
    """
    wanted = json.loads(json.dumps(settings, default=str))  # as they come back from a file
    if path.exists():
        before = json.loads(path.read_text())["settings"]
        changed = [k for k in wanted.keys() | before.keys() if before.get(k) != wanted.get(k)]
        if changed:
            raise InputError(
                f"{path.parent} was begun with other settings: "
                + ", ".join(
                    f"{k} is {before.get(k)!r} there, {wanted.get(k)!r} here"
                    for k in sorted(changed)
                )
                + "; give another --out, or delete the folder"
            )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {"settings": wanted, **(more or {})})


def remove_leftovers(*folders: Path) -> None:
    """Removes what runs that were killed left under temporary names, in the folders themselves.

    Files of a process that still runs are left untouched: it is about to rename them.
    """
    for folder in folders:
        for path in folder.iterdir() if folder.is_dir() else ():
            match = _TEMPORARY.fullmatch(path.name)
            if match is not None and not _runs(int(match[1])):
                path.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    """Whether another process of this number runs on this machine."""
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return process != os.getpid()
