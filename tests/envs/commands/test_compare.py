"""The command ``compare``: it makes the page again by itself, and names wrong calls."""

import pytest
from two_view_pose.__main__ import main
from two_view_pose.core.results import write_results
from two_view_pose.pose_estimator.study import run as study_run

RECORD = {"metric": "test_set", "value": 1, "unit": "pairs", "scene": "linemod", "sequences": 1,
          "references": 1, "settings": "{}"}  # fmt: skip


def test_report_only_renders_the_page_from_results(tmp_path, monkeypatch, capsys):
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
