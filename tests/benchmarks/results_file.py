"""The results file, from which an interrupted run resumes.

Every record has the conditions under which it was measured. A group ends with a record of its
duration; a group without one was interrupted and is measured again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import two_view_pose
from two_view_pose.core.processor import describe_processor, number_format
from two_view_pose.core.results import read_results, versions, write_results

from .config import GROUPS
from .stopwatch import Record

FINISHED = "group_seconds"
"""Metric of the record that ends a group."""

WITH_NETWORKS = {"network", *(name for name, group in GROUPS.items() if group.needs_weights)}
"""Groups whose results depend on the number format that our networks compute in."""


def conditions(**options: Any) -> dict[str, str]:
    """Returns what results depend on: the processor, our code and the options, as tags."""
    package = Path(two_view_pose.__file__).parent
    folders = sorted(path.parent for path in package.glob("*/__init__.py"))
    sha = hashlib.sha256()
    for folder in (*folders, Path(__file__).parent):
        for path in sorted(folder.rglob("*.py")):
            sha.update(path.read_bytes())
    said = " ".join(f"{name}={value}" for name, value in options.items())
    return {"processor": describe_processor(), "code": sha.hexdigest()[:16], "options": said}


@dataclass
class ResultsFile:
    """The records of a run, and their file.

    Attributes:
        path: the results file, or None to keep them in memory only.
        seed: of the run.
        conditions: see :func:`conditions`.
        records: what has been measured.
    """

    path: Path | None
    seed: int
    conditions: dict[str, str]
    records: list[Record] = field(default_factory=list)

    def resume(self, groups: Sequence[str]) -> str:
        """Resumes after the finished groups of an interrupted run; returns a message about it.

        Raises:
            ValueError: if there is a file at ``path`` that is not a results file.
        """
        if self.path is None or not self.path.exists():
            return ""
        document = read_results(self.path)
        found = document["records"]
        changed = [
            f"{name} {record.get(name, 'unknown')!r}, now {value!r}"
            for name, value in self.conditions.items()
            for record in found[:1]
            if record.get(name) != value
        ]
        head = {"versions": versions(), "seed": self.seed}
        changed += [name for name, value in head.items() if document[name] != value]
        if changed:
            return f"{self.path} has other conditions and is measured again: {'; '.join(changed)}"
        done = {record["group"] for record in found if record["metric"] == FINISHED}
        if done.issuperset(groups):
            return f"{self.path} is complete and is measured again"
        self.records = [record for record in found if record["group"] in done]
        return f"{self.path} resumes after {', '.join(g for g in groups if g in done) or 'nothing'}"

    def finished(self, group: str) -> bool:
        """Whether a group is complete."""
        return any(r["metric"] == FINISHED and r["group"] == group for r in self.records)

    def add(self, group: str, line: Record) -> None:
        """Adds a record, and writes the file atomically."""
        networks = {"number_format": number_format()} if group in WITH_NETWORKS else {}
        self.records.append({**line, **networks, "group": group, **self.conditions})
        if self.path is not None:
            write_results(self.path, self.records, command="bench", seed=self.seed)

    def finish(self, group: str, seconds: float) -> None:
        """Records that a group is complete, and its duration."""
        self.add(group, {"metric": FINISHED, "value": seconds, "unit": "s"})
