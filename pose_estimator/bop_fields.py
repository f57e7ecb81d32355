"""Checked fields of BOP files: every complaint is a ValueError that names file, place and field."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .geometry import check_rigid

MM = 1000.0
"""Millimetres in a metre."""

ROTATION_TOLERANCE = 5e-2
"""How far from orthonormal a rotation on disk may be; it is then replaced by the nearest one."""


def read_json(path: Path, kind: type | tuple[type, ...]) -> Any:
    """The content of a JSON file whose outermost value is of ``kind``."""
    try:
        content = json.loads(path.read_text())
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise ValueError(f"{path} is not valid JSON (truncated?): {error}") from error
    if not isinstance(content, kind):
        raise ValueError(f"{path} must not hold a JSON {type(content).__name__}")
    return content


def required(entry: Mapping[str, Any], name: str, where: str) -> Any:
    """The field ``name`` of an entry that must have it."""
    if not isinstance(entry, dict) or name not in entry:
        raise ValueError(f"{where}: field {name!r} is missing")
    return entry[name]


def integer(value: Any, where: str) -> int:
    """``value`` as a whole number."""
    try:
        return int(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: expected a whole number, got {value!r}") from error


def array(
    entries: Sequence[Mapping[str, Any]], name: str, size: int, places: Sequence[str]
) -> np.ndarray:
    """The field ``name`` of all entries as float64 (N, size); refuses what is not finite."""
    try:
        values = np.array([e[name] for e in entries], dtype=np.float64).reshape(len(entries), size)
        if np.isfinite(values).all():
            return values
    except (KeyError, TypeError, ValueError):
        pass
    for entry, where in zip(entries, places, strict=True):
        value = required(entry, name, where)
        try:
            row = np.array(value, dtype=np.float64).ravel()
        except (TypeError, ValueError):
            row = np.empty(0)
        if row.size != size or not np.isfinite(row).all():
            what = "a finite number" if size == 1 else f"{size} finite numbers"
            raise ValueError(f"{where}: field {name!r} must be {what}, got {str(value)[:80]}")
    raise ValueError(f"{places[0]}: field {name!r} is not the same shape everywhere")


def transforms(
    entries: Sequence[Mapping[str, Any]], rotation: str, translation: str, places: Sequence[str]
) -> np.ndarray:
    """Rotations and translations in millimetres of all entries as (N, 4, 4) in metres."""
    T = np.tile(np.eye(4), (len(entries), 1, 1))
    T[:, :3, :3] = array(entries, rotation, 9, places).reshape(-1, 3, 3)
    T[:, :3, 3] = array(entries, translation, 3, places) / MM
    return rigid(T, [f"{place}: field {rotation!r}" for place in places])


def rotation_errors(rotations: np.ndarray) -> np.ndarray:
    """How far matrices (N, 3, 3) are from orthonormal, (N,); infinite for those that mirror."""
    errors = np.abs(rotations @ rotations.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    return np.where(np.linalg.det(rotations) < 0, np.inf, errors)


def rigid(T: np.ndarray, places: Sequence[str]) -> np.ndarray:
    """Transforms (N, 4, 4) with rotations that are orthonormal to the last digit.

    Recorded datasets are careless here (some of LM-O's are off by 1 percent), and later checks
    would refuse them.

    Raises:
        ValueError: if one is further off than ``ROTATION_TOLERANCE``.
    """
    rotations = T[:, :3, :3]
    errors = rotation_errors(rotations)
    for i in np.flatnonzero(errors > ROTATION_TOLERANCE).tolist():
        check_rigid(T[i], places[i], ROTATION_TOLERANCE)
    rounded = errors > 1e-12
    U, _, Vt = np.linalg.svd(rotations[rounded])
    T[rounded, :3, :3] = U @ Vt
    return T
