"""Records as rows of a table."""

from benchmarks import table
from benchmarks.stopwatch import make_record
from rich.console import Console


def ratio_record(**tags):
    return {**make_record("ours", "theirs", [1.0, 2.0, 9.0], [6.0, 5.0], 3.0), **tags}


def test_a_row_says_how_many_times_as_fast_ours_is():
    row = table.cells(ratio_record())
    assert row == ("ours", "theirs", "2e+03 ms", "5.5e+03 ms", "2.75x", ">= 3x")
    assert not table.met(ratio_record()) and table.met(ratio_record(goal=2.75))


def test_a_row_of_operations():
    record = ratio_record(flops_per_second=2e11, flops_per_second_against=1e12)
    assert table.cells(record)[2:4] == ("200 GFLOP/s", "1000 GFLOP/s")


def test_a_rate_has_no_alternative():
    record = {"metric": "images_per_second", "value": 9.26, "work": "generate", "goal": 8.0}
    assert table.cells(record) == ("generate", "", "9.3/s", "", "", ">= 8/s")


def test_what_has_no_goal_is_left_out():
    records = [ratio_record(), {"metric": "seconds", "value": 1.0, "unit": "s", "work": "hidden"}]
    console = Console(width=120)
    with console.capture() as captured:
        console.print(table.table(records))
    assert "missed" in captured.get() and "hidden" not in captured.get()


def test_a_line_in_markdown():
    text = table.markdown([ratio_record(goal=2.0), {"metric": "seconds", "value": 1.0}])
    assert text.splitlines()[0] == "| work | against | ours | theirs | ratio | goal | |"
    assert len(text.splitlines()) == 3 and text.endswith("| >= 2x | met |\n")


def test_the_page_says_on_what_it_was_measured_and_what_holds_only_there():
    half = {"processor": "Model 7, 2 cores, AVX-512", "number_format": "bfloat16"}
    text = table.markdown([ratio_record(**half)])
    assert text.startswith("Measured on Model 7, 2 cores, AVX-512. Lines marked bfloat16 hold only")
    assert "| ours (bfloat16) | theirs |" in text
    single = table.markdown([ratio_record(processor="Model 3", number_format="float32")])
    assert single.startswith("Measured on Model 3.\n\n|") and "bfloat16" not in single
