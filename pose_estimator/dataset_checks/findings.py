"""Findings of the dataset checks, grouped by problem and cause."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from ..bop.fields import Place

Severity = Literal["error", "warning"]

MAX_KEPT = 100
"""Findings of a group to store; further ones are only counted."""

_DATA_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".ply")


@dataclass(frozen=True)
class Finding:
    """One problem in one place.

    Attributes:
        severity: ``error`` if the data is unusable, ``warning`` if it may be intended.
        field: the field of the file, or a part of it such as ``pixels``.
        problem: the problem, in the same words wherever it occurs.
        cause: the probable cause.
        remedy: what to do.
        place: scene, image and annotation.
        detail: the values here.
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
        """The file's name; for images and meshes a pattern such as ``rgb/*.png``."""
        if self.file.suffix.lower() in _DATA_SUFFIXES:
            return f"{self.file.parent.name}/*{self.file.suffix}"
        return self.file.name

    def example(self, root: Path) -> str:
        """Returns the path relative to ``root``, the place and the detail in one line."""
        file = self.file.relative_to(root) if self.file.is_relative_to(root) else self.file
        within = "" if self.kind != self.file.name else str(replace(self.place, scene=None))
        where = f"{file}, {within}" if within else str(file)
        return f"{where}: {self.detail}" if self.detail else where


@dataclass
class Group:
    """Findings of the same problem: their number, and the first ``MAX_KEPT`` of them."""

    count: int = 0
    kept: list[Finding] = field(default_factory=list)

    @property
    def first(self) -> Finding:
        """The first finding; all share its severity, kind of file, field, problem and cause."""
        return self.kept[0]


class Findings:
    """Collects findings in groups."""

    def __init__(self) -> None:
        self._groups: dict[tuple[str, ...], Group] = {}

    def add(self, finding: Finding) -> None:
        """Adds one finding to its group."""
        key = (finding.severity, finding.kind, finding.field, finding.problem, finding.cause)
        group = self._groups.setdefault(key, Group())
        group.count += 1
        if len(group.kept) < MAX_KEPT:
            group.kept.append(finding)

    def error(self, file: Path, field: str, problem: str, **more: Any) -> None:
        """Adds an error; ``more`` as in `Finding`."""
        self.add(Finding("error", file, field, problem, **more))

    def warning(self, file: Path, field: str, problem: str, **more: Any) -> None:
        """Adds a warning; ``more`` as in `Finding`."""
        self.add(Finding("warning", file, field, problem, **more))

    def groups(self) -> list[Group]:
        """Returns the groups, errors before warnings, each in order of detection."""
        return sorted(self._groups.values(), key=lambda group: group.first.severity != "error")

    def count(self, severity: Severity | None = None) -> int:
        """Returns the number of findings, of one severity or in total."""
        return sum(g.count for g in self.groups() if severity in (None, g.first.severity))

    def records(self) -> list[dict[str, Any]]:
        """Returns records of a results file: each group's count and first finding."""
        records = []
        for group in self.groups():
            first, count = group.first, {"metric": "findings", "value": group.count, "unit": "1"}
            names = ("severity", "field", "problem", "cause", "remedy", "detail")
            words = {name: getattr(first, name) for name in names}
            place = {name: getattr(first.place, name) for name in ("scene", "image", "annotation")}
            records.append(count | {"file": str(first.file)} | words | place)
        return records
