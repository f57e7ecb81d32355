"""JSON files and fields that may be damaged: what can be read, and a finding for what cannot."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .data_findings import Findings, Place

LARGEST = 1e9
"""No number of a BOP file is larger."""

REPAIR = "write the file anew, or fetch it again"


def read_raw_json(path: Path, kind: type | tuple[type, ...], findings: Findings) -> Any:
    """A JSON file's content, or None where it is broken; keys that are there twice are named."""
    twice: list[str] = []

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(items)
        if len(content) < len(items):
            keys = [key for key, _ in items]
            twice.extend(sorted({key for key in keys if keys.count(key) > 1}))
        return content

    try:
        content = json.loads(path.read_text(), object_pairs_hook=pairs)
    except FileNotFoundError:
        findings.error(path, "file", "is missing", remedy="restore the file or write it anew")
        return None
    except OSError as error:
        findings.error(path, "file", "cannot be read", detail=str(error.strerror), remedy=REPAIR)
        return None
    except (ValueError, RecursionError) as error:
        findings.error(
            path, "file", "is not valid JSON", detail=str(error),
            cause="truncated by a full disk or a killed process, or edited by hand", remedy=REPAIR,
        )  # fmt: skip
        return None
    for key in twice:
        findings.error(
            path, "keys", "a key is there twice", detail=f"key {key!r}",
            cause="scenes were joined without new numbers; readers see the last one alone",
            remedy="give each picture and object a number of its own",
        )  # fmt: skip
    if not isinstance(content, kind):
        findings.error(
            path, "file", "holds the wrong kind of JSON", remedy="see BOP's description of formats",
            detail=f"a {type(content).__name__} instead of {_name(kind)}",
        )  # fmt: skip
        return None
    return content


def _name(kind: type | tuple[type, ...]) -> str:
    kinds = kind if isinstance(kind, tuple) else (kind,)
    return " or ".join(f"a {k.__name__}" for k in kinds)


def read_numbers(
    entries: Sequence[Any],
    name: str,
    size: int,
    path: Path,
    places: Sequence[Place],
    findings: Findings,
    optional: bool = False,
) -> np.ndarray:
    """The field ``name`` of all entries as float64 (N, size), NaN rows where it is broken."""
    try:
        values = np.array([e[name] for e in entries], dtype=np.float64).reshape(len(entries), size)
        if (np.abs(values) < LARGEST).all():
            return values
    except (KeyError, TypeError, ValueError):
        pass
    values = np.full((len(entries), size), np.nan)
    for row, (entry, place) in enumerate(zip(entries, places, strict=True)):
        if not isinstance(entry, dict) or name not in entry:
            if not optional:
                findings.error(path, name, "the field is missing", place=place, remedy=REPAIR)
            continue
        try:
            given = [] if entry[name] is None else entry[name]
            numbers = np.array(given, dtype=np.float64).ravel()
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.size != size:
            problem = "must be a number" if size == 1 else f"must be {size} numbers"
        elif not (np.abs(numbers) < LARGEST).all():
            problem = "is NaN, infinite or far too large"
        else:
            values[row] = numbers
            continue
        findings.error(
            path, name, problem, place=place, detail=str(entry[name])[:60],
            cause="a failed fit or a division by zero" if "NaN" in problem else "",
            remedy="remove the annotation or compute it anew",
        )  # fmt: skip
    return values
