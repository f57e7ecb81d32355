"""What a study has measured so far, one line a pair of views, so that a killed run can resume."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ...core.errors import InputError
from ...core.files import write_atomically


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


class OutcomeLog:
    """A file that outcomes are appended to, below a line with the key of how they were made.

    Args:
        path: the file; its folder is made where missing.
        key: all that the outcomes depend on, as JSON values.
        commit: of the code that runs now.

    Attributes:
        key: as given.
        outcomes: all so far.
        commits: of the code of each run that the outcomes are from.

    Raises:
        InputError: if the file holds outcomes of another key, or something else. It is left as it
            is.
    """

    def __init__(self, path: str | Path, key: Mapping[str, Any], commit: str | None = None):
        self.path = Path(path)
        self.key = key
        self.outcomes: list[PairOutcome] = []
        self.commits: list[str] = []
        if self.path.exists():
            self._read()
        if commit is not None and commit not in self.commits:
            self.commits = [*self.commits, commit]
        # Written again, because a killed run may have left half a line at the end.
        head = {"key": key, "commits": self.commits}
        text = "\n".join([json.dumps(head), *map(_line, self.outcomes)]) + "\n"
        write_atomically(self.path, text.encode())

    def add(self, outcomes: Iterable[PairOutcome]) -> None:
        """Appends outcomes to the file."""
        new = list(outcomes)
        with self.path.open("a") as file:
            file.writelines(_line(outcome) + "\n" for outcome in new)
        self.outcomes += new

    def _read(self) -> None:
        key = json.loads(json.dumps(self.key))
        # What follows the last line break is half a line, or nothing.
        lines = self.path.read_text().split("\n")[:-1]
        advice = "choose another --out, or remove the file to measure again"
        try:
            head, *contents = map(json.loads, lines)
            kept, self.commits = head["key"], head["commits"]
            self.outcomes = [
                PairOutcome(**{**content, "distances": tuple(content["distances"])})
                for content in contents
            ]
        except (json.JSONDecodeError, KeyError, TypeError, ValueError) as error:
            raise InputError(f"{self.path} is not a file of outcomes; {advice}") from error
        if kept != key:
            names = [name for name in {**key, **kept} if kept.get(name) != key.get(name)]
            raise InputError(f"{self.path} was measured with another {', '.join(names)}; {advice}")


def _line(outcome: PairOutcome) -> str:
    return json.dumps(asdict(outcome), separators=(",", ":"), allow_nan=False)
