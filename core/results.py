"""The results file that every command writes for ``--json``: a flat list of records.

The document is ``{"command", "versions", "seed", "records"}``; a record is ``{"metric", "value",
"unit", ...tags}``. Records are validated when written: JSON has no NaN.
"""

import contextlib
import json
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from types import NoneType
from typing import Any

from .errors import InputError
from .files import write_atomically
from .text_files import read_text
from .validation import is_number

PACKAGES = (
    "two-view-pose",
    "gymnasium",
    "mujoco",
    "numpy",
    "opencv-python-headless",
    "safetensors",
    "scipy",
    "stable-baselines3",
    "torch",
    "trimesh",
)
"""Distributions whose versions can change a result."""


@cache
def versions() -> dict[str, str]:
    """Versions of Python and of the installed `PACKAGES`, which are not imported."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


@cache
def commit() -> str | None:
    """The commit of this checkout, or None for an installed wheel."""
    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return None
    try:
        answer = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, timeout=10
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() if answer.returncode == 0 else None


def check_record(record: Mapping[str, Any]) -> dict[str, Any]:
    """Validates a record and converts NumPy scalars to Python's.

    A record has ``metric`` (text), ``value`` (a finite number), ``unit`` (text) and any tags, whose
    values are text, finite numbers, booleans or None.

    Raises:
        InputError: if a key is missing or a value has another type.
    """
    if not isinstance(record, Mapping):
        raise InputError(f"a record must map names to values, got {str(record)[:80]}")
    plain = {k: value.item() if hasattr(value, "item") else value for k, value in record.items()}
    kinds: dict[str, tuple[type, ...]] = {"metric": (str,), "value": (int, float), "unit": (str,)}
    for key in kinds | plain:
        value, types = plain.get(key), kinds.get(key, (str, int, float, bool, NoneType))
        infinite = type(value) in (int, float) and not is_number(value)
        if infinite or type(value) not in types:
            allowed = ", ".join(kind.__name__ for kind in types)
            raise InputError(
                f"record's {key[:40]} must be finite and of type {allowed}, got {value!r:.80}: "
                f"{plain!s:.300}"
            )
    return plain


def write_results(
    path: str | os.PathLike[str],
    records: Iterable[Mapping[str, Any]],
    *,
    command: str,
    seed: int | None,
) -> None:
    """Writes a results file atomically, each record on a line of its own.

    Args:
        path: the JSON file; its folder is created.
        records: see `check_record`.
        command: the command line.
        seed: the seed of the command, None without random numbers.

    Raises:
        InputError: if a record is malformed.
    """
    document: dict[str, Any] = {"command": command, "versions": versions(), "seed": seed}
    head = json.dumps(document | {"records": []}, indent=1).removesuffix("[]\n}")
    lines = [json.dumps(check_record(record), allow_nan=False) for record in records]
    listed = "[\n  " + ",\n  ".join(lines) + "\n ]" if lines else "[]"
    write_atomically(path, f"{head}{listed}\n}}\n".encode())


def read_results(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Reads a results file.

    Raises:
        InputError: if it is not a results file.
    """
    try:
        document = json.loads(read_text(Path(path)))
    except (ValueError, RecursionError) as error:
        raise InputError(f"results file {path} is not JSON: {error}") from error
    keys = {"command", "versions", "seed", "records"}
    if not isinstance(document, dict) or set(document) != keys:
        found = sorted(document) if isinstance(document, dict) else type(document).__name__
        raise InputError(
            f"results file {path} must have the keys {sorted(keys)}, got {found!s:.200}"
        )
    kinds: dict[str, Any] = {
        "command": str,
        "versions": dict,
        "seed": (int, NoneType),
        "records": list,
    }
    for key, kind in kinds.items():
        if not isinstance(document[key], kind) or isinstance(document[key], bool):
            raise InputError(f"results file {path}: {key} is wrong: {document[key]!r:.80}")
    try:
        document["records"] = [check_record(record) for record in document["records"]]
    except InputError as error:
        raise InputError(f"results file {path}: {error}") from error
    return document
