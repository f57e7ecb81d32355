"""A run that is killed and started again ends as one that was not, see ``kill_and_resume``."""

from __future__ import annotations

from pathlib import Path

from helpers.kill_and_resume import kill_and_resume


def test_killed_runs_end_as_if_they_had_not_been(tmp_path: Path) -> None:
    log = kill_and_resume(tmp_path, kills=3, scenes=3, workers=1)
    assert sum(line.startswith("kill") for line in log) == 3
    assert log[-1].startswith("finished: the same")
