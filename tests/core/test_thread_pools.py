"""Threads on one core each, and what else runs on the machine."""

import os
import subprocess
import sys
import time

import pytest
import torch
from two_view_pose.core.cpu_cores import available_cores, idle_cores
from two_view_pose.core.thread_pools import shared_pool, single_core_threads


def test_pool_threads_use_one_core_each():
    before = torch.get_num_threads()
    pool = single_core_threads(3)

    def compute(number: int) -> int:
        torch.ones(2**20).add_(number).sum()  # enough to be shared among cores
        return torch.get_num_threads()

    assert list(pool.map(compute, range(12))) == [1] * 12
    assert torch.get_num_threads() == before
    pool.shutdown()


def test_pools_are_cached():
    assert shared_pool(2) is shared_pool(2)
    assert shared_pool(2) is not shared_pool(3)


@pytest.mark.skipif(not os.path.exists("/proc/loadavg"), reason="only Linux tells what runs")
def test_busy_processes_leave_fewer_idle_cores():
    code = "print(flush=True)\nwhile True: pass"
    busy = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
        for _ in range(2 * (os.cpu_count() or 1))
    ]
    try:
        for process in busy:
            process.stdout.readline()
        time.sleep(0.2)
        assert idle_cores() == 1
    finally:
        for process in busy:
            process.kill()
            process.communicate()
    assert 1 <= idle_cores() <= available_cores()
