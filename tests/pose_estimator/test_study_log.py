"""What is kept of a study that was killed."""

import json
from dataclasses import replace

import pytest
from two_view_pose.pose_estimator.study_log import OutcomeLog, PairOutcome

FIRST = PairOutcome(3, 0, 5, "cat", 5, 0.02, (0.001, 0.003), 0.8, 0.9, 4.5, 0.1, {"soft": 0.02})
SECOND = replace(FIRST, ref_image_id=1, error=0.3)
SETTINGS = {"unit": {"gaps": (1, 5)}, "seed": 0}


def test_the_mean_over_the_keypoints():
    assert FIRST.keypoint_distance == pytest.approx(0.002)


def test_outcomes_come_back(tmp_path):
    path = tmp_path / "sub" / "a.jsonl"
    OutcomeLog(path, SETTINGS, "one").add([FIRST, SECOND])
    again = OutcomeLog(path, SETTINGS, "two")
    assert again.outcomes == [FIRST, SECOND]
    assert again.commits == ["one", "two"]


def test_half_a_line_is_forgotten(tmp_path):
    path = tmp_path / "a.jsonl"
    OutcomeLog(path, SETTINGS).add([FIRST, SECOND])
    path.write_text(path.read_text()[:-40])
    log = OutcomeLog(path, SETTINGS)
    assert log.outcomes == [FIRST]
    log.add([SECOND])
    assert OutcomeLog(path, SETTINGS).outcomes == [FIRST, SECOND]


def test_other_settings_start_anew(tmp_path):
    path = tmp_path / "a.jsonl"
    OutcomeLog(path, SETTINGS, "one").add([FIRST])
    log = OutcomeLog(path, {**SETTINGS, "seed": 1}, "two")
    assert log.outcomes == [] and log.commits == ["two"]
    assert len(path.read_text().splitlines()) == 1


@pytest.mark.parametrize("line", ["[1, 2]", "nonsense", json.dumps({"error": 0.1}), ""])
def test_lines_of_something_else_are_not_outcomes(tmp_path, line):
    path = tmp_path / "a.jsonl"
    OutcomeLog(path, SETTINGS).add([FIRST])
    path.write_text(path.read_text() + line + "\n")
    assert OutcomeLog(path, SETTINGS).outcomes == [FIRST]
    path.write_text(line)
    assert OutcomeLog(path, SETTINGS).outcomes == []
