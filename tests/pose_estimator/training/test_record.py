"""The log of a training, also after a killed run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from two_view_pose.core.errors import InputWarning
from two_view_pose.pose_estimator.training.record import TrainingLog

GOOD = {"stage": "detector", "step": 40, "held_out/recall": 0.9}


def test_half_a_line_does_not_swallow_the_next_entry(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text(json.dumps(GOOD) + "\n" + json.dumps(GOOD)[:30])
    with pytest.warns(InputWarning, match=r"log\.jsonl: line 2 is not an entry.*1 ignored"):
        log = TrainingLog(path, resume=True)
    log("features", 20, {"held_out/angle": 3.0})
    with pytest.warns(InputWarning):
        again = TrainingLog(path, resume=True)
    assert again.held_out == {"detector/recall": 0.9, "features/angle": 3.0}


@pytest.mark.parametrize(
    "line",
    ["3", "[]", "{}", '{"stage": 3}', '{"stage": "a", "held_out/x": "1"}', "[" * 100_000,
     '{"stage": "a", "held_out/x": NaN}'],
)  # fmt: skip
def test_lines_of_something_else_are_ignored_with_a_warning(tmp_path: Path, line: str) -> None:
    path = tmp_path / "log.jsonl"
    path.write_text(f"{line}\n{json.dumps(GOOD)}\n")
    with pytest.warns(InputWarning, match="line 1 is not an entry"):
        assert TrainingLog(path, resume=True).held_out == {"detector/recall": 0.9}
