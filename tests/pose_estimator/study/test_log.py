"""Logs of outcomes, also after a killed run."""

import json
from dataclasses import replace

import pytest
from two_view_pose.core.errors import InputError
from two_view_pose.pose_estimator.study.log import OutcomeLog, PairOutcome

FIRST = PairOutcome(3, 0, 5, "cat", 5, 0.02, (0.001, 0.003), 0.8, 0.9, 4.5, {"soft": 0.02})
SECOND = replace(FIRST, ref_image_id=1, error=0.3)
KEY = {"unit": {"gaps": (1, 5)}, "seed": 0}


def test_the_mean_over_the_keypoints():
    assert FIRST.keypoint_distance == pytest.approx(0.002)


def test_outcomes_are_read_back(tmp_path):
    path = tmp_path / "sub" / "a.jsonl"
    OutcomeLog(path, KEY, "one").add([FIRST, SECOND])
    again = OutcomeLog(path, KEY, "two")
    assert again.outcomes == [FIRST, SECOND]
    assert again.commits == ["one", "two"]


def test_an_incomplete_line_is_dropped(tmp_path):
    path = tmp_path / "a.jsonl"
    OutcomeLog(path, KEY).add([FIRST, SECOND])
    path.write_text(path.read_text()[:-40])
    log = OutcomeLog(path, KEY)
    assert log.outcomes == [FIRST]
    log.add([SECOND])
    assert OutcomeLog(path, KEY).outcomes == [FIRST, SECOND]


def test_outcomes_of_another_key_are_reported_and_kept(tmp_path):
    path = tmp_path / "a.jsonl"
    OutcomeLog(path, KEY, "one").add([FIRST])
    before = path.read_text()
    with pytest.raises(
        ValueError, match=r"a\.jsonl was measured with another seed; choose another"
    ):
        OutcomeLog(path, {**KEY, "seed": 1}, "two")
    with pytest.raises(ValueError, match="another format, networks;"):
        OutcomeLog(path, {**KEY, "format": 2, "networks": "0123"})
    assert path.read_text() == before


@pytest.mark.parametrize("line", ["[1, 2]", "nonsense", '{"error": 0.1}', ""])
def test_files_of_something_else_are_refused(tmp_path, line):
    path = tmp_path / "a.jsonl"
    OutcomeLog(path, KEY).add([FIRST])
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(ValueError, match=r"a\.jsonl is not a file of outcomes"):
        OutcomeLog(path, KEY)
    path.write_text(line + "\n")
    with pytest.raises(ValueError, match="is not a file of outcomes"):
        OutcomeLog(path, KEY)


@pytest.mark.parametrize(
    ("name", "value"),
    [("error", "0.1"), ("error", -1), ("error", float("nan")), ("gap", 1.5), ("scene_id", None),
     ("distances", []), ("distances", [[0.1]]), ("solver_errors", {"soft": None}),
     ("object_name", 3), ("visibility", 10**400)],
)  # fmt: skip
def test_values_of_another_kind_are_refused(tmp_path, name, value):
    path = tmp_path / "a.jsonl"
    OutcomeLog(path, KEY).add([FIRST])
    head, line, _ = path.read_text().split("\n")
    path.write_text(head + "\n" + json.dumps(json.loads(line) | {name: value}) + "\n")
    with pytest.raises(InputError, match=r"a\.jsonl is not a file of outcomes"):
        OutcomeLog(path, KEY)


@pytest.mark.parametrize("head", ['{"key": 3, "commits": []}', '{"key": {}, "commits": [[]]}'])
def test_a_damaged_first_line_is_refused(tmp_path, head):
    path = tmp_path / "a.jsonl"
    for content in (head.encode(), b"\xff" + head.encode(), b"[" * 100_000):
        path.write_bytes(content + b"\n")
        with pytest.raises(InputError, match=r"a\.jsonl"):
            OutcomeLog(path, KEY)
