"""Both sides take turns, and a record says what came of it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

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


def test_things_come_one_by_one_from_another_process_and_so_does_its_error():
    things = stopwatch.each_from_own_process(range, 3)
    assert list(things) == [0, 1, 2]
    with pytest.raises(ZeroDivisionError):
        list(stopwatch.each_from_own_process(divmod, 1, 0))
    with pytest.raises(ChildProcessError, match="ended with code 3"):
        list(stopwatch.each_from_own_process(os._exit, 3))


def test_who_stops_listening_ends_the_process():
    endless = stopwatch.each_from_own_process(iter, os.getpid, None)
    child = next(endless)
    endless.close()
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


def test_a_process_that_is_interrupted_ends_its_own():
    code = (
        "import time; from two_view_pose.pose_estimator import stopwatch\n"
        "if __name__ == '__main__':\n"
        "    print('ready', flush=True)\n"
        "    list(stopwatch.each_from_own_process(time.sleep, 60))"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    run.stdout.readline()
    children = Path(f"/proc/{run.pid}/task/{run.pid}/children")
    deadline = time.monotonic() + 60
    # Its own is the last of two: the first keeps count of what processes share.
    while children.is_file() and len(children.read_text().split()) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.1)
    time.sleep(1.0)
    run.send_signal(signal.SIGINT)
    _, errors = run.communicate(timeout=30)  # which ends when all that share its pipes have
    assert run.returncode != 0 and "KeyboardInterrupt" in errors
