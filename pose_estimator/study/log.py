"""Logs of outcomes, one line for each pair of views, which make a study resumable."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ...core.errors import InputError
from ...core.files import naming, write_atomically
from ...core.text_files import read_text
from ...core.validation import is_number


@dataclass(frozen=True)
class PairOutcome:
    """Errors of the estimate of one object in one pair of views.

    Attributes:
        gap: frames between the views.
        error: ADD, or ADD-S for symmetric objects, in diameters.
        distances: error of each of the nine 3D keypoints, m.
        camera_baseline: distance between the centers of the two cameras, m.
        visibility: of the target in the reference view, 0 to 1.
        baseline: angle between the views as seen from the object, degrees.
        solver_errors: ``error`` of the pose that each solver finds from the same keypoints.
    """

    scene_id: int
    ref_image_id: int
    second_image_id: int
    object_name: str
    gap: int
    error: float
    distances: tuple[float, ...]
    camera_baseline: float
    visibility: float
    baseline: float
    solver_errors: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[int, int, int, str]:
        return self.scene_id, self.ref_image_id, self.second_image_id, self.object_name

    @property
    def keypoint_distance(self) -> float:
        """Mean over the keypoints, m."""
        return sum(self.distances) / len(self.distances)


class OutcomeLog:
    """A JSON-lines file of outcomes, below a line with the key of how they were made.

    Args:
        path: the file; its folder is made where missing.
        key: all that the outcomes depend on, as JSON values.
        commit: of the running code.

    Attributes:
        outcomes: all so far.
        commits: of the code that measured them.

    Raises:
        InputError: if the file has another key or format; it is left unchanged.
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
        # Rewrites the file, because a killed run may have left half a line at the end.
        head = json.dumps({"key": key, "commits": self.commits}) + "\n"
        write_atomically(self.path, "".join([head, *map(_line, self.outcomes)]).encode())

    def add(self, outcomes: Iterable[PairOutcome]) -> None:
        """Appends outcomes to the file."""
        new = list(outcomes)
        with naming(self.path), self.path.open("a") as file:
            file.writelines(map(_line, new))
        self.outcomes += new

    def _read(self) -> None:
        key = json.loads(json.dumps(self.key))
        advice = "choose another --out, or remove the file to measure again"
        try:
            # An incomplete last line has no line break.
            head, *entries = map(json.loads, read_text(self.path).split("\n")[:-1])
            logged, self.commits = dict(head["key"]), list(head["commits"])
            if not all(isinstance(commit, str) for commit in self.commits):
                raise TypeError("commits must be text")
            self.outcomes = [_outcome(entry) for entry in entries]
        except (KeyError, RecursionError, TypeError, ValueError) as error:
            problem = f"{self.path} is not a file of outcomes ({error})"
            raise InputError(f"{problem}; {advice}") from error
        if logged != key:
            names = [n[:40] for n in {**key, **logged} if logged.get(n) != key.get(n)]
            raise InputError(f"{self.path} was measured with another {', '.join(names)}; {advice}")


def _outcome(entry: Any) -> PairOutcome:
    """Returns a line's outcome; raises TypeError or ValueError where a value is not one."""
    outcome = PairOutcome(**{**entry, "distances": tuple(entry["distances"])})
    numbers = {**entry, **{f"distance {i}": d for i, d in enumerate(outcome.distances)}}
    numbers |= {f"solver_errors {name}": e for name, e in dict(outcome.solver_errors).items()}
    for name in numbers.keys() - {"object_name", "distances", "solver_errors"}:
        integer, value = name.endswith("_id") or name == "gap", numbers[name]
        if not is_number(value) or value < 0 or (integer and type(value) is not int):
            raise ValueError(f"{name} is {value!r:.40}")
    if not isinstance(outcome.object_name, str) or not outcome.distances:
        raise ValueError(f"object_name is {outcome.object_name!r:.40}")
    return outcome


def _line(outcome: PairOutcome) -> str:
    return json.dumps(asdict(outcome), separators=(",", ":"), allow_nan=False) + "\n"
