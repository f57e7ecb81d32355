"""What ``bench`` has measured so far, in its results file: an interrupted run goes on there.

Every record says under which conditions it was measured, and each group ends with one that says how
long it took: a group without it was interrupted and is measured again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..pose_estimator.processor import describe_processor, number_format
from ..pose_estimator.results import read_results, versions, write_results
from ..pose_estimator.stopwatch import Missing, Record

FINISHED = "group_seconds"
"""Metric of the record that ends a group."""

MISSING = "missing"
"""Metric of a comparison that was not made."""

WITH_NETWORKS = ("vector", "estimator", "network", "busy", "cost")
"""Groups whose figures depend on the number format that our networks compute in."""

_CODE = ("assets", "envs", "pose_estimator")


def conditions(**options: Any) -> dict[str, str]:
    """What figures depend on: the processor, our code and the options, as tags of a record."""
    root = Path(__file__).resolve().parents[1]
    sha = hashlib.sha256()
    for folder in _CODE:
        for path in sorted((root / folder).rglob("*.py")):
            sha.update(path.read_bytes())
    said = " ".join(f"{name}={value}" for name, value in options.items())
    return {"processor": describe_processor(), "code": sha.hexdigest()[:16], "options": said}


@dataclass
class Measured:
    """The records of a run.

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
        """Takes over the finished groups of a run that was interrupted; says what is done, and why.

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
        changed += [name for name in ("versions", "seed") if document[name] != self._head()[name]]
        if changed:
            return f"{self.path} has other conditions and is measured anew: {'; '.join(changed)}"
        done = {record["group"] for record in found if record["metric"] == FINISHED}
        if done.issuperset(groups):
            return f"{self.path} is complete and is measured anew"
        self.records = [record for record in found if record["group"] in done]
        return f"{self.path} goes on after {', '.join(g for g in groups if g in done) or 'nothing'}"

    def missing(self) -> list[Missing]:
        """The comparisons that were not made."""
        found = [r for r in self.records if r["metric"] == MISSING]
        return [Missing(r["against"], r["reason"], r["install"]) for r in found]

    def finished(self, group: str) -> bool:
        """Whether all of a group is there."""
        return any(r["metric"] == FINISHED and r["group"] == group for r in self.records)

    def add(self, group: str, line: Record | Missing) -> None:
        """Keeps a line, in the file too."""
        if isinstance(line, Missing):
            line = {
                "metric": MISSING,
                "value": 0,
                "unit": "",
                "against": line.against,
                "reason": line.reason,
                "install": line.install,
            }
        elif group in WITH_NETWORKS:
            line = {**line, "number_format": number_format()}
        self.records.append({**line, "group": group, **self.conditions})
        self.write()

    def finish(self, group: str, seconds: float) -> None:
        """Notes that a group is complete, and how long it took."""
        self.add(group, {"metric": FINISHED, "value": seconds, "unit": "s"})

    def write(self) -> None:
        """Writes the results file, whole or not at all."""
        if self.path is not None:
            write_results(self.path, self.records, command="bench", seed=self.seed)

    def _head(self) -> dict[str, Any]:
        return {"versions": versions(), "seed": self.seed}
