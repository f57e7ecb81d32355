"""What is wrong with a dataset: single findings, grouped so that equal ones are one line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from ..bop.fields import Place

Severity = Literal["error", "warning"]

KEPT = 100
"""So many findings of a group are kept in full; the others are counted."""

_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif")


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong in one place.

    Attributes:
        severity: ``error`` where the data cannot be used as it is, ``warning`` where it may be
            meant.
        file: the file that holds it.
        field: the field of the file, or the part of it, such as ``pixels``.
        problem: what it is, in words that are the same wherever it occurs.
        cause: what is probably behind it.
        remedy: what to do.
        place: scene, image and annotation.
        detail: what it is here, with its numbers.
    """

    severity: Severity
    file: Path
    field: str
    problem: str
    cause: str = ""
    remedy: str = ""
    place: Place = Place()
    detail: str = ""

    @property
    def kind(self) -> str:
        """The file's name; for images and meshes the pattern that theirs follow."""
        if self.file.suffix.lower() in _IMAGE_SUFFIXES:
            return f"{self.file.parent.name}/*{self.file.suffix}"
        if self.file.suffix == ".ply":
            return f"{self.file.parent.name}/*.ply"
        return self.file.name

    def example(self, root: Path) -> str:
        """Where below ``root`` it is and what it is there, in one line."""
        file = self.file.relative_to(root) if self.file.is_relative_to(root) else self.file
        within = "" if self.kind != self.file.name else str(replace(self.place, scene=None))
        where = f"{file}, {within}" if within else str(file)
        return f"{where}: {self.detail}" if self.detail else where


@dataclass
class Group:
    """Equal findings.

    Attributes:
        count: how many there are.
        kept: the first ``KEPT`` of them.
    """

    count: int = 0
    kept: list[Finding] = field(default_factory=list)

    @property
    def first(self) -> Finding:
        """What is the same for all: severity, kind of file, field, problem, cause, remedy."""
        return self.kept[0]


class Findings:
    """Collects findings; 10 000 equal ones cost no more than 100."""

    def __init__(self) -> None:
        self._groups: dict[tuple[str, ...], Group] = {}

    def add(self, finding: Finding) -> None:
        """Adds one finding to its group."""
        key = (finding.severity, finding.kind, finding.field, finding.problem, finding.cause)
        group = self._groups.setdefault(key, Group())
        group.count += 1
        if len(group.kept) < KEPT:
            group.kept.append(finding)

    def error(self, file: Path, field: str, problem: str, **more: Any) -> None:
        """Adds an error; ``more`` as in `Finding`."""
        self.add(Finding("error", file, field, problem, **more))

    def warning(self, file: Path, field: str, problem: str, **more: Any) -> None:
        """Adds a warning; ``more`` as in `Finding`."""
        self.add(Finding("warning", file, field, problem, **more))

    def groups(self) -> list[Group]:
        """Errors before warnings, in each the order in which they were found."""
        return sorted(self._groups.values(), key=lambda group: group.first.severity != "error")

    def __iter__(self) -> Iterator[Finding]:
        for group in self.groups():
            yield from group.kept

    def count(self, severity: Severity | None = None) -> int:
        """How many findings there are, of one severity or in all."""
        return sum(g.count for g in self.groups() if severity in (None, g.first.severity))

    def records(self) -> list[dict[str, Any]]:
        """Records of a results file: each group with its count and its first example."""
        records = []
        for group in self.groups():
            first, count = group.first, {"metric": "findings", "value": group.count, "unit": "1"}
            names = ("severity", "field", "problem", "cause", "remedy", "detail")
            words = {name: getattr(first, name) for name in names}
            place = {name: getattr(first.place, name) for name in ("scene", "image", "annotation")}
            records.append(count | {"file": str(first.file)} | words | place)
        return records
