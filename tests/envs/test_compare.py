"""The verb ``compare``: it hands both tests to the study, and makes the page again by itself."""

from pathlib import Path

import pytest
from two_view_pose.__main__ import main
from two_view_pose.envs import study_data
from two_view_pose.envs.compare import compare
from two_view_pose.pose_estimator import study, study_run
from two_view_pose.pose_estimator.results import read_results, write_results
from two_view_pose.pose_estimator.study_config import CompareConfig

RECORD = {"metric": "test_set", "value": 1, "unit": "pairs", "scene": "linemod", "sequences": 1,
          "references": 1, "settings": "{}"}  # fmt: skip


def test_both_tests_are_made_and_given_to_the_study(tmp_path, monkeypatch):
    made, seen = [], {}

    def ensure(name: str, root: Path, quick: bool) -> Path:
        made.append((name, root, quick))
        return root / name

    class Study:
        def __init__(self, config, tests):
            seen.update(tests=dict(tests), config=config)

        def run(self):
            return [RECORD]

    monkeypatch.setattr(study_data, "ensure_test_set", ensure)
    monkeypatch.setattr(study.StudySet, "open", lambda name, root: (name, root))
    monkeypatch.setattr(study_run, "Study", Study)
    compare(CompareConfig(out=tmp_path / "out", quick=True, seed=9))
    root = tmp_path / "out" / "data"
    assert made == [("linemod", root, True), ("occlusion", root, True)]
    assert seen["tests"] == {n: (n, root / n) for n in ("linemod", "occlusion")}
    assert seen["config"].noise_pairs == 1
    document = read_results(tmp_path / "out" / "results.json")
    assert document["seed"] == 9 and document["command"] == "compare --out out --quick --seed 9"
    assert document["records"] == [RECORD]
    assert "1 reference frames" in (tmp_path / "out" / "report.html").read_text()


def test_the_page_is_made_again_from_the_results(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study_run, "Study", None)
    write_results(tmp_path / "results.json", [RECORD], command="compare --out a", seed=0)
    before = (tmp_path / "results.json").read_bytes()
    assert main(["compare", "--report-only", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").is_file()
    assert (tmp_path / "results.json").read_bytes() == before
    assert "report.html" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--report-only"], "holds no results.json"),
        (["--methods", "mud"], "methods must be some of single"),
    ],
)
def test_wrong_calls_are_named(tmp_path, options, message, capsys):
    try:
        code = main(["compare", "--out", str(tmp_path), *options])
    except SystemExit as stop:
        code = stop.code
    assert code == 2
    assert message in capsys.readouterr().err
