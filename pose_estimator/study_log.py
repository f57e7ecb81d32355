"""What a study has measured so far, one line a pair of views, so that a killed run goes on."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from .results import write_atomically


@dataclass(frozen=True)
class PairOutcome:
    """One object in one pair of views, estimated and compared with the truth.

    Attributes:
        scene_id: the sequence.
        ref_image_id: the reference view.
        second_image_id: the second view.
        object_name: the target.
        gap: frames between the views.
        error: ADD, or ADD-S for symmetric objects, in diameters.
        distances: how far each of the nine 3D keypoints is from the truth, m.
        camera_distance: from the reference camera to the object's origin, m.
        visibility: of the target in the reference view, 0 to 1.
        baseline: angle between the views as seen from the object, degrees.
        seconds: that the estimate took.
        solver_errors: ``error`` had the pose been solved from the same keypoints by each solver.
    """

    scene_id: int
    ref_image_id: int
    second_image_id: int
    object_name: str
    gap: int
    error: float
    distances: tuple[float, ...]
    camera_distance: float
    visibility: float
    baseline: float
    seconds: float
    solver_errors: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[int, int, int, str]:
        """What was estimated."""
        return self.scene_id, self.ref_image_id, self.second_image_id, self.object_name

    @property
    def keypoint_distance(self) -> float:
        """Mean over the keypoints, m."""
        return sum(self.distances) / len(self.distances)


_NAMES = frozenset(f.name for f in fields(PairOutcome))


class OutcomeLog:
    """A file that outcomes are added to, below a line that says how they were made.

    What an earlier run left is read if it was made in the same way, and replaced if not.

    Args:
        path: the file; its folder is made where missing.
        settings: all that the outcomes depend on, as JSON values.
        commit: of the code that runs now.

    Attributes:
        outcomes: all so far.
        commits: of the code of each run that the outcomes are from.
    """

    def __init__(self, path: str | Path, settings: Mapping[str, Any], commit: str | None = None):
        self.path = Path(path)
        self.outcomes: list[PairOutcome] = []
        self.commits: list[str] = []
        lines = self.path.read_text().splitlines() if self.path.exists() else []
        head = _content(lines[0]) if lines else {}
        if head.get("settings") == json.loads(json.dumps(settings)):
            self.outcomes = list(_whole_lines(lines[1:]))
            self.commits = head["commits"]
        if commit is not None and commit not in self.commits:
            self.commits = [*self.commits, commit]
        # Written anew, because a killed run may have left half a line at the end.
        head = {"settings": settings, "commits": self.commits}
        text = "\n".join([json.dumps(head), *map(_line, self.outcomes)]) + "\n"
        write_atomically(self.path, text.encode())

    def add(self, outcomes: Iterable[PairOutcome]) -> None:
        """Appends outcomes to the file."""
        new = list(outcomes)
        with self.path.open("a") as file:
            file.writelines(_line(outcome) + "\n" for outcome in new)
        self.outcomes += new


def _line(outcome: PairOutcome) -> str:
    return json.dumps(asdict(outcome), separators=(",", ":"), allow_nan=False)


def _whole_lines(lines: Iterable[str]) -> Iterable[PairOutcome]:
    """The outcomes up to the first line that is not whole."""
    for line in lines:
        content = _content(line)
        if set(content) != _NAMES:
            return
        yield PairOutcome(**{**content, "distances": tuple(content["distances"])})


def _content(line: str) -> dict[str, Any]:
    """What a line holds; nothing if it is not whole."""
    try:
        content = json.loads(line)
    except json.JSONDecodeError:
        return {}
    return content if isinstance(content, dict) else {}
