"""Reads and validates fields of BOP files.

Invalid fields are passed to a callback of type `Report`. The default, `refuse`, raises; a linter
passes one that collects them, and gets NaN for invalid values.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ...core.errors import InputError
from ...core.geometry import check_rigid
from ...core.text_files import read_text

MM = 1000.0
"""Millimeters in a meter."""

MAX_VALUE = 1e9
"""Larger numbers in a BOP file are invalid."""

ROTATION_TOLERANCE = 5e-2
"""Largest deviation from orthonormal of a rotation on disk; it is replaced by the nearest one."""

MAX_VISIBLE = 1.001
"""Largest visible fraction on disk: that of a whole object is a quotient, and may be rounded."""

REPAIR = "write or download the file again"

Report = Callable[..., None]
"""Takes file, field, problem, and the keywords ``place``, ``detail``, ``cause`` and ``remedy``."""


@dataclass(frozen=True)
class Place:
    """A location in a dataset; None where a field does not apply.

    Attributes:
        scene: scene id.
        image: image id.
        annotation: position in the image's list of annotations.
        entry: entry of a file outside the scenes, such as ``pair 3``.
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
    """Raises an InputError that names file, place and field."""
    where = f"{file}, {place}:" if place != Place() else f"{file}:"
    if field == "file":
        where = f"{file}"
    elif not problem.startswith(("a ", "an ")):  # else the problem names what it is about
        where += f" field {field!r}"
    problem = problem.removeprefix("the field ")
    raise InputError(f"{where} {problem}" + (f" ({detail})" if detail else ""))


def read_json(path: Path, kind: type | tuple[type, ...], report: Report = refuse) -> Any:
    """Returns the content of a JSON file, of type ``kind``; None where it is invalid."""
    duplicates: list[str] = []

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(items)
        if len(content) < len(items):
            keys = [key for key, _ in items]
            duplicates.extend(sorted({key for key in keys if keys.count(key) > 1}))
        return content

    try:
        # JSON readers take the last of equal keys; finding duplicates triples the time.
        hook = None if report is refuse else pairs
        content = json.loads(read_text(path), object_pairs_hook=hook)
    except FileNotFoundError:
        report(path, "file", "is missing", remedy="restore the file or write it again")
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
    for key in duplicates:
        report(
            path, "keys", "a key is duplicated", detail=f"key {key!r}",
            cause="scenes were merged without renumbering; readers see only the last entry",
            remedy="give each image and object an id of its own",
        )  # fmt: skip
    if not isinstance(content, kind):
        kinds = kind if isinstance(kind, tuple) else (kind,)
        expected = " or ".join(k.__name__ for k in kinds)
        report(
            path, "file", "has the wrong JSON type", remedy="see BOP's description of formats",
            detail=f"expected {expected}, got {type(content).__name__}",
        )  # fmt: skip
        return None
    return content


def is_id(text: str) -> bool:
    """Whether a key or a name of a file is an id: up to nine of the digits 0 to 9."""
    return text.isascii() and text.isdigit() and len(text) < len(str(int(MAX_VALUE)))


def read_ids(
    entries: Sequence[Any],
    name: str,
    path: Path,
    places: Sequence[Place],
    report: Report = refuse,
) -> np.ndarray:
    """Returns the field ``name`` of all entries, integers >= 0, as float64 (N,); NaN if invalid."""
    ids = read_numbers(entries, name, 1, path, places, report)[:, 0]
    for row in np.flatnonzero((ids < 0) | (ids % 1 > 0)).tolist():
        report(
            path, name, "must be an integer >= 0", place=places[row], detail=f"{ids[row]:g}",
            remedy="write the id of a scene, an image or an object",
        )  # fmt: skip
        ids[row] = np.nan
    return ids


def read_numbers(
    entries: Sequence[Any],
    name: str,
    size: int,
    path: Path,
    places: Sequence[Place],
    report: Report = refuse,
    *,
    optional: bool = False,
    max_value: float = MAX_VALUE,
) -> np.ndarray:
    """Returns the field ``name`` of all entries as float64 (N, size); invalid rows are NaN."""
    try:
        values = np.array([e[name] for e in entries], dtype=np.float64).reshape(len(entries), size)
        if (np.abs(values) < max_value).all():
            return values
    except (KeyError, OverflowError, TypeError, ValueError):
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
        except OverflowError:
            numbers = np.full(size, np.inf)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.size != size:
            problem = "must be a number" if size == 1 else f"must be {size} numbers"
        elif not (np.abs(numbers) < max_value).all():
            problem = "is NaN, infinite or too large"
        else:
            values[row] = numbers
            continue
        report(
            path, name, problem, place=place, detail=str(entry[name])[:60],
            cause="a failed fit or a division by zero" if "NaN" in problem else "",
            remedy="remove the annotation or compute it again",
        )  # fmt: skip
    return values


def read_transforms(
    entries: Sequence[Any],
    names: tuple[str, str],
    path: Path,
    places: Sequence[Place],
    report: Report = refuse,
) -> np.ndarray:
    """Returns rotations and translations in millimeters as (N, 4, 4) in meters, NaN if invalid.

    Rotations are not made orthonormal: see `rigid`.
    """
    T = np.tile(np.eye(4), (len(entries), 1, 1))
    T[:, :3, :3] = read_numbers(entries, names[0], 9, path, places, report).reshape(-1, 3, 3)
    T[:, :3, 3] = read_numbers(entries, names[1], 3, path, places, report) / MM
    T[np.isnan(T).any(axis=(1, 2))] = np.nan
    return T


def rotation_errors(rotations: np.ndarray) -> np.ndarray:
    """Returns max |R R^T - I| of matrices (N, 3, 3) as (N,); infinite for reflections."""
    errors = np.abs(rotations @ rotations.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    return np.where(np.linalg.det(rotations) < 0, np.inf, errors)


def rigid(T: np.ndarray, name: Callable[[int], str] = str) -> np.ndarray:
    """Makes the rotations of transforms (N, 4, 4) orthonormal in place, and returns the transforms.

    Recorded datasets store rounded rotations (some of LM-O's are off by 1 percent).

    Raises:
        InputError: if an error, or that of a last row, exceeds ``ROTATION_TOLERANCE``; ``name(i)``
            names the transform.
    """
    errors = rotation_errors(T[:, :3, :3])
    last = np.abs(T[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0)
    for i in np.flatnonzero(np.maximum(errors, last) > ROTATION_TOLERANCE).tolist():
        check_rigid(T[i], name(i), ROTATION_TOLERANCE)
    T[:, 3] = [0.0, 0.0, 0.0, 1.0]
    rounded = errors > 1e-12
    U, _, Vt = np.linalg.svd(T[rounded, :3, :3])
    T[rounded, :3, :3] = U @ Vt
    return T
