"""An interrupted run keeps its records, and resumes only under the same conditions."""

import json

import pytest
from benchmarks import command, stopwatch
from benchmarks.config import BenchConfig
from benchmarks.results_file import FINISHED, ResultsFile
from two_view_pose.core.results import read_results

GROUPS = ("rendering", "solver")


def line(work, value=2.0):
    return {**stopwatch.make_record(work, "theirs", [1.0], [value], 1.0)}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs a bench of two made-up groups; returns which were measured and the file's records."""
    path = tmp_path / "bench.json"

    def run(groups, repeats=1, seed=0):
        measured = []

        def each(function, group, config):
            measured.append(group)
            for found in groups[group]:
                if isinstance(found, BaseException):
                    raise found
                yield found

        monkeypatch.setattr(command, "each_from_own_process", each)
        config = BenchConfig(only=GROUPS, repeats=repeats, seed=seed, json=path)
        try:
            command.bench(config)
        except KeyboardInterrupt:
            measured.append("interrupted")
        return measured, read_results(path)["records"]

    run.path = path
    return run


FIRST = [line("a"), line("b")]
SECOND = [line("c"), line("d")]
INTERRUPTED = {"rendering": FIRST, "solver": [SECOND[0], KeyboardInterrupt()]}
COMPLETE = {"rendering": FIRST, "solver": SECOND}


def works(records):
    return [record["work"] for record in records if record["metric"] == "ratio"]


def test_lines_of_an_interrupted_run_are_kept_and_the_next_resumes(run, capsys):
    measured, records = run(INTERRUPTED)
    assert measured == ["rendering", "solver", "interrupted"]
    assert works(records) == ["a", "b", "c"]
    assert [r["group"] for r in records if r["metric"] == FINISHED] == ["rendering"]
    capsys.readouterr()

    measured, records = run({"solver": SECOND})
    assert measured == ["solver"]
    assert works(records) == ["a", "b", "c", "d"]
    printed = capsys.readouterr().out
    assert "resumes after rendering" in " ".join(printed.split())
    assert "1/2 rendering" in printed and "2/2 solver" in printed


def test_a_complete_run_is_measured_again(run):
    run(COMPLETE)
    measured, records = run({"rendering": [line("a", 5.0), line("b")], "solver": SECOND})
    assert measured == list(GROUPS)
    assert works(records) == ["a", "b", "c", "d"] and records[0]["value"] == 5.0


@pytest.mark.parametrize("change", ["repeats", "seed", "processor", "code", "versions"])
def test_records_of_other_conditions_are_not_mixed(run, change, capsys):
    run(INTERRUPTED)
    document = json.loads(run.path.read_text())
    if change == "versions":
        document["versions"]["torch"] = "0.1"
    elif change in ("processor", "code"):
        for record in document["records"]:
            record[change] = "another"
    run.path.write_text(json.dumps(document))
    options = {change: 7} if change in ("repeats", "seed") else {}
    capsys.readouterr()
    measured, records = run(COMPLETE, **options)
    assert measured == list(GROUPS) and works(records) == ["a", "b", "c", "d"]
    assert "other conditions and is measured again" in " ".join(capsys.readouterr().out.split())


def test_another_file_is_not_overwritten(run):
    run.path.write_text('{"precious": 1}')
    with pytest.raises(ValueError, match="must have the keys"):
        run(COMPLETE)
    assert run.path.read_text() == '{"precious": 1}'


def test_each_line_is_printed_when_it_is_measured(run, capsys):
    printed = []

    def lines():
        for found in FIRST:
            yield found
            printed.append(capsys.readouterr().out)

    run({"rendering": lines(), "solver": SECOND})
    assert "2.00x  a | theirs (goal >= 1x: met)" in printed[0] and "  b |" not in printed[0]
    assert "2.00x  b | theirs" in printed[1]


def test_without_a_file_nothing_is_kept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    measured = ResultsFile(None, 0, {"processor": "p"})
    assert measured.resume(GROUPS) == ""
    measured.add("solver", line("a"))
    assert measured.records[0]["processor"] == "p" and not list(tmp_path.iterdir())
