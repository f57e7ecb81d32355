"""The folder of a generated dataset: whose it is, and what killed runs left in it."""

from __future__ import annotations

import json
import os
import re
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..pose_estimator.bop_writer import write_json
from ..pose_estimator.results import versions
from .checksums import SUMS_FILE
from .scene_plan import target_names

if TYPE_CHECKING:
    from .generate import GenerateConfig

_ASIDE = ("out", "workers", "scenes", "json", "coco", "worker_memory", "ray", "verify")
"""Settings that do not change what a scene looks like."""

_ONLY_WITH = {
    "gaps": ("hand-held", "mixed"),
    "references": ("hand-held", "mixed"),
    "stereo_baseline": ("stereo",),
}
"""Settings that mean something with some samplings only."""

_BEFORE: dict[str, Any] = {
    "sampling": "sphere",
    "layout": "basic",
    "look": "tidy",
    "distractors": [],
}
"""What versions did that did not know these settings."""

_TEMPORARY = re.compile(r"\..+\.(\d+)\.tmp")
"""The names under which files are written, see ``results.write_atomically``."""


def claim_folder(config: GenerateConfig, object_names: tuple[str, ...]) -> GenerateConfig:
    """Writes manifest.json, or checks that the one that is there says the same.

    A folder that an older version began goes on in the layout that it has.

    Args:
        config: what is to be generated.
        object_names: names of its objects.

    Returns:
        The configuration with the layout of the folder.

    Raises:
        ValueError: if the folder holds a dataset that was made with other settings.
    """
    path = config.out / "manifest.json"
    before = json.loads(path.read_text())["settings"] if path.exists() else None
    if before is not None and "layout" not in before:
        config = replace(config, layout="basic")
    everything = _settings(config, object_names)
    # What is as it was before there was a choice is not written.
    settings = {k: v for k, v in everything.items() if k not in _BEFORE or v != _BEFORE[k]}
    if before is not None:
        # What an older version did not know was as it is by default now.
        defaults = _as_json({f.name: f.default for f in fields(config) if f.name in settings})
        before = defaults | _BEFORE | before
        changed = [name for name in everything if before.get(name) != everything[name]]
        if changed:
            raise ValueError(
                f"{config.out} holds a dataset with other settings: "
                + ", ".join(
                    f"{k} is {before.get(k)!r} there, {everything[k]!r} here" for k in changed
                )
                + "; give another --out"
            )
    config.out.mkdir(parents=True, exist_ok=True)
    content = {"settings": settings, "scenes": config.scenes, "versions": versions()}
    write_json(path, content | ({"checksums": SUMS_FILE} if "layout" in settings else {}))
    return config


def remove_leftovers(*folders: Path) -> None:
    """Removes what runs that were killed left under temporary names, in the folders themselves.

    Files of a process that still runs are let alone: it is about to rename them.
    """
    for folder in folders:
        for path in folder.iterdir() if folder.is_dir() else ():
            match = _TEMPORARY.fullmatch(path.name)
            if match is not None and not _runs(int(match[1])):
                path.unlink(missing_ok=True)


def _settings(config: GenerateConfig, object_names: tuple[str, ...]) -> dict[str, Any]:
    """What fixes the bytes of every scene, as it comes back from a file."""
    names = {
        "objects": target_names(config, object_names),
        "distractors": object_names[len(object_names) - len(config.distractors) :],
    }
    aside = {*_ASIDE, *(k for k, kinds in _ONLY_WITH.items() if config.sampling not in kinds)}
    settings = {k: v for k, v in (asdict(config) | names).items() if k not in aside}
    return _as_json(settings)


def _as_json(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings as they come back from a file: tuples become lists."""
    return json.loads(json.dumps(settings))


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
