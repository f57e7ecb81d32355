"""Both sides take turns, and a record says what came of it."""

import os

import pytest
from two_view_pose.pose_estimator import stopwatch
from two_view_pose.pose_estimator.results import check_record


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


def test_another_process_answers():
    assert stopwatch.in_own_process(os.getpid) != os.getpid()
    with pytest.raises(ZeroDivisionError):
        stopwatch.in_own_process(divmod, 1, 0)
