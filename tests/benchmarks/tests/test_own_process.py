"""A generator in another process: its items, and its end."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from benchmarks.own_process import each_from_own_process

TESTS = Path(__file__).parents[2]


def test_items_come_one_by_one_from_another_process_and_so_does_its_error():
    assert list(each_from_own_process(range, 3)) == [0, 1, 2]
    with pytest.raises(ZeroDivisionError):
        list(each_from_own_process(divmod, 1, 0))
    with pytest.raises(ChildProcessError, match="ended with code 3"):
        list(each_from_own_process(os._exit, 3))


def test_closing_the_iterator_ends_the_process():
    endless = each_from_own_process(iter, os.getpid, None)
    child = next(endless)
    assert child != os.getpid()
    endless.close()
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


@pytest.mark.slow
def test_a_process_that_is_interrupted_ends_its_own():
    code = (
        "import signal, time; from benchmarks.own_process import each_from_own_process\n"
        "if __name__ == '__main__':\n"
        # Shells start background jobs with SIGINT ignored, and children inherit that.
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "    print('ready', flush=True)\n"
        "    list(each_from_own_process(time.sleep, 60))"
    )
    run = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=TESTS,
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
