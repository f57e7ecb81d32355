"""Timing of both sides in turn, and the record."""

import time

import pytest
from benchmarks import stopwatch
from two_view_pose.core.results import check_record


def test_a_ratio_says_how_many_times_as_fast_ours_is():
    record = stopwatch.make_record("ours", "theirs", [1.0, 2.0, 9.0], [6.0, 5.0, 1.0], goal=3.0)
    assert record["value"] == 2.5
    assert check_record(record) == record
    per_thing = stopwatch.make_record("ours", "theirs", [4.0], [2.0], goal=1.0, share=4)
    assert (per_thing["value"], per_thing["seconds"]) == (0.5, 1.0)


def test_calls_take_turns_and_the_first_do_not_count():
    order = []
    times = stopwatch.in_turn([lambda: order.append("a"), lambda: order.append("b")], 3)
    assert order == ["a", "b"] * (3 + stopwatch.WARM_UP)
    assert [len(t) for t in times] == [3, 3]


@pytest.mark.slow
def test_what_prepares_our_side_is_not_timed():
    record = stopwatch.ratio(
        "ours",
        "theirs",
        lambda step: time.sleep(step),
        lambda: time.sleep(0.01),
        repeats=2,
        goal=1.0,
        prepare=lambda: (time.sleep(0.1), 0.01)[1:],
    )
    assert 0.01 <= record["seconds"] < 0.1 and record["n"] == 2
