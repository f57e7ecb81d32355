"""Busy processes compute, and end with their block or parent."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from benchmarks import table
from benchmarks.groups import busy
from two_view_pose.core.cpu_cores import available_cores
from two_view_pose.core.results import check_record

TESTS = Path(__file__).parents[2]
has_proc = pytest.mark.skipif(not os.path.exists("/proc/self"), reason="asks /proc")


def gone(pids):
    """Whether none of the processes runs any more, within some seconds."""
    for _ in range(100):
        if not any(os.path.exists(f"/proc/{pid}") for pid in pids):
            return True
        time.sleep(0.1)
    return False


def ticks(pid):
    """CPU time of a process, clock ticks."""
    with open(f"/proc/{pid}/stat") as file:
        return int(file.read().rpartition(")")[2].split()[11])


@pytest.mark.slow
@has_proc
def test_they_compute_and_end_with_the_block():
    with pytest.raises(RuntimeError, match="in between"), busy.busy_processes(2) as running:
        pids = [process.pid for process in running]
        before = [ticks(pid) for pid in pids]
        time.sleep(1.0)
        assert all(ticks(pid) > then for pid, then in zip(pids, before, strict=True))
        raise RuntimeError("in between")
    assert all(process.returncode is not None for process in running)
    assert gone(pids)


@pytest.mark.slow
@has_proc
def test_they_end_with_a_parent_that_is_killed():
    code = (
        "import os, signal\n"
        "from benchmarks.groups.busy import busy_processes\n"
        "with busy_processes(2) as running:\n"
        "    print(*[process.pid for process in running], flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=TESTS)
    pids = [int(pid) for pid in run.stdout.split()]
    assert len(pids) == 2 and gone(pids)


def test_the_ratio_is_alone_against_busy(monkeypatch):
    calls = []
    record = busy.compare("work", lambda: calls.append(time.sleep(0.01)), repeats=2)
    check_record(record)
    count = 2 * available_cores()
    assert record["work"] == f"work, with {count} busy processes"
    assert record["value"] == pytest.approx(record["seconds_against"] / record["seconds"])
    assert record["goal"] == 0.25 and table.met({**record, "value": 0.26})
    assert len(calls) == 2 + busy.WARM_UP + 2


@pytest.mark.slow
def test_a_training_step_changes_the_network():
    step = busy.training_step()
    cells = [cell.cell_contents for cell in step.__closure__]
    (network,) = (value for value in cells if isinstance(value, torch.nn.Module))
    before = {name: value.clone() for name, value in network.state_dict().items()}
    step()
    after = network.state_dict()
    changed = [n for n in before if "weight" in n and not (after[n] == before[n]).all()]
    assert len(changed) > len(before) / 5
