"""Output and files of the benchmark command."""

import json
from pathlib import Path

import pytest
from benchmarks import command, stopwatch
from benchmarks.config import BenchConfig
from benchmarks.table import markdown
from two_view_pose.core import results

BENCHMARKS = Path(__file__).parents[1]


def test_wrong_options_are_refused(capsys):
    with pytest.raises(ValueError, match="'speed'"):
        BenchConfig(only=("speed",))
    with pytest.raises(ValueError, match="group cost"):
        BenchConfig(only=("solver",), figure=Path("f.png"))
    assert command.main(["--soak", "10"]) == 2
    assert "error: soak must be at least 100 steps, got 10" in capsys.readouterr().err


def test_without_weights_groups_that_need_them_are_skipped():
    groups = BenchConfig(weights=None, json=Path("f.json")).groups
    assert {"vector", "estimator", "busy", "cost"}.isdisjoint(groups) and "rendering" in groups


def test_what_is_missing_is_printed_and_the_rest_is_written(tmp_path, monkeypatch, capsys):
    record = stopwatch.make_record("ours", "theirs", [1.0, 2.0, 9.0], [6.0, 5.0], 3.0)
    found = [record, stopwatch.missing("a peer", "it is not there", "pip install peer")]
    monkeypatch.setattr(command, "each_from_own_process", lambda *_: iter(found))
    options = ["--only", "solver", "--json", tmp_path / "f.json", "--markdown", tmp_path / "f.md"]
    assert command.main([str(option) for option in options]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "not compared with a peer (it is not there). To install it: pip install peer" in printed
    record, absent, _ = results.read_results(tmp_path / "f.json")["records"]
    assert (record["metric"], record["goal"], record["n"]) == ("ratio", 3.0, 3)
    assert (absent["metric"], absent["against"]) == ("missing", "a peer")
    assert "| 2.75x | >= 3x | missed |" in (tmp_path / "f.md").read_text()


@pytest.mark.slow
def test_groups_run_in_processes_of_their_own_from_the_folder(tmp_path):
    path = tmp_path / "f.json"
    assert command.main(["--only", "import", "--repeats", "1", "--json", str(path)]) == 0
    record, _ = results.read_results(path)["records"]
    assert record["group"] == "import" and record["against"] == "import gymnasium"


def test_readme_has_the_stored_results():
    stored = json.loads((BENCHMARKS / "results" / "results.json").read_text())
    assert markdown(stored["records"]) in (BENCHMARKS.parents[1] / "README.md").read_text()
