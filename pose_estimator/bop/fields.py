"""Fields of BOP files, checked.

What is broken is handed to a callback of the kind `Report`. The default, `refuse`, raises; a linter
passes one that collects, and reads on with NaN in the place of what is missing.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ...core.errors import InputError
from ...core.geometry import check_rigid

MM = 1000.0
"""Millimeters in a meter."""

LARGEST = 1e9
"""No number of a BOP file is larger."""

ROTATION_TOLERANCE = 5e-2
"""How far from orthonormal a rotation on disk may be; it is then replaced by the nearest one."""

REPAIR = "write the file anew, or fetch it again"

Report = Callable[..., None]
"""Takes file, field and problem, and by name ``place``, ``detail``, ``cause`` and ``remedy``."""


@dataclass(frozen=True)
class Place:
    """Where in a dataset something stands; None where it does not apply.

    Attributes:
        scene: number of the scene.
        image: number of the image.
        annotation: position in the image's list of annotations.
        entry: the entry of a file that is not of a scene, such as ``pair 3``.
    """

    scene: int | None = None
    image: int | None = None
    annotation: int | None = None
    entry: str = ""

    def __str__(self) -> str:
        names = {"scene": self.scene, "image": self.image, "annotation": self.annotation}
        parts = [f"{name} {number}" for name, number in names.items() if number is not None]
        return ", ".join([*parts, self.entry] if self.entry else parts)


def refuse(
    file: Path, field: str, problem: str, *, place: Place = Place(), detail: str = "", **_: str
) -> NoReturn:
    """Raises a ValueError that names file, place and field."""
    where = f"{file}, {place}:" if place != Place() else f"{file}:"
    if field == "file":
        where = f"{file}"
    elif not problem.startswith(("a ", "an ")):
        where += f" field {field!r}"
    problem = problem.removeprefix("the field ")
    raise InputError(f"{where} {problem}" + (f" ({detail})" if detail else ""))


def read_json(path: Path, kind: type | tuple[type, ...], report: Report = refuse) -> Any:
    """The content of a JSON file whose outermost value is of ``kind``; None where it is broken."""
    twice: list[str] = []

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(items)
        if len(content) < len(items):
            keys = [key for key, _ in items]
            twice.extend(sorted({key for key in keys if keys.count(key) > 1}))
        return content

    try:
        # Readers take the last of equal keys; to look for them takes three times as long.
        hook = None if report is refuse else pairs
        content = json.loads(path.read_text(), object_pairs_hook=hook)
    except FileNotFoundError:
        report(path, "file", "is missing", remedy="restore the file or write it anew")
        return None
    except OSError as error:
        report(path, "file", "cannot be read", detail=str(error.strerror), remedy=REPAIR)
        return None
    except (ValueError, RecursionError) as error:
        report(
            path, "file", "is not valid JSON", detail=str(error),
            cause="truncated by a full disk or a killed process, or edited by hand", remedy=REPAIR,
        )  # fmt: skip
        return None
    for key in twice:
        report(
            path, "keys", "a key is there twice", detail=f"key {key!r}",
            cause="scenes were joined without new numbers; readers see the last one alone",
            remedy="give each image and object a number of its own",
        )  # fmt: skip
    if not isinstance(content, kind):
        kinds = kind if isinstance(kind, tuple) else (kind,)
        expected = " or ".join(f"a {k.__name__}" for k in kinds)
        report(
            path, "file", "holds the wrong kind of JSON", remedy="see BOP's description of formats",
            detail=f"a {type(content).__name__} instead of {expected}",
        )  # fmt: skip
        return None
    return content


def read_numbers(
    entries: Sequence[Any],
    name: str,
    size: int,
    path: Path,
    places: Sequence[Place],
    report: Report = refuse,
    *,
    optional: bool = False,
    largest: float = LARGEST,
) -> np.ndarray:
    """The field ``name`` of all entries as float64 (N, size), NaN rows where it is broken."""
    try:
        values = np.array([e[name] for e in entries], dtype=np.float64).reshape(len(entries), size)
        if (np.abs(values) < largest).all():
            return values
    except (KeyError, TypeError, ValueError):
        pass
    values = np.full((len(entries), size), np.nan)
    for row, (entry, place) in enumerate(zip(entries, places, strict=True)):
        if not isinstance(entry, dict) or name not in entry:
            if not optional:
                report(path, name, "the field is missing", place=place, remedy=REPAIR)
            continue
        try:
            given = [] if entry[name] is None else entry[name]
            numbers = np.array(given, dtype=np.float64).ravel()
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.size != size:
            problem = "must be a number" if size == 1 else f"must be {size} numbers"
        elif not (np.abs(numbers) < largest).all():
            problem = "is NaN, infinite or far too large"
        else:
            values[row] = numbers
            continue
        report(
            path, name, problem, place=place, detail=str(entry[name])[:60],
            cause="a failed fit or a division by zero" if "NaN" in problem else "",
            remedy="remove the annotation or compute it anew",
        )  # fmt: skip
    return values


def read_transforms(
    entries: Sequence[Any],
    names: tuple[str, str],
    path: Path,
    places: Sequence[Place],
    report: Report = refuse,
) -> np.ndarray:
    """Rotations and translations in millimeters as (N, 4, 4) in meters, NaN where one is broken.

    Rotations are left as they are: see `rigid`.
    """
    T = np.tile(np.eye(4), (len(entries), 1, 1))
    T[:, :3, :3] = read_numbers(entries, names[0], 9, path, places, report).reshape(-1, 3, 3)
    T[:, :3, 3] = read_numbers(entries, names[1], 3, path, places, report) / MM
    T[np.isnan(T).any(axis=(1, 2))] = np.nan
    return T


def rotation_errors(rotations: np.ndarray) -> np.ndarray:
    """How far matrices (N, 3, 3) are from orthonormal, (N,); infinite for those that mirror."""
    errors = np.abs(rotations @ rotations.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    return np.where(np.linalg.det(rotations) < 0, np.inf, errors)


def rigid(T: np.ndarray, name: Callable[[int], str] = str) -> np.ndarray:
    """Transforms (N, 4, 4) with rotations that are orthonormal to the last digit, in place.

    Recorded datasets are careless here (some of LM-O's are off by 1 percent), and later checks
    would refuse them.

    Raises:
        InputError: if one is further off than ``ROTATION_TOLERANCE``; ``name`` says what to call
            it by its number.
    """
    rotations = T[:, :3, :3]
    errors = rotation_errors(rotations)
    for i in np.flatnonzero(errors > ROTATION_TOLERANCE).tolist():
        check_rigid(T[i], name(i), ROTATION_TOLERANCE)
    rounded = errors > 1e-12
    U, _, Vt = np.linalg.svd(rotations[rounded])
    T[rounded, :3, :3] = U @ Vt
    return T
