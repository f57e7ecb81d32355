"""Threads on one core each, and what else runs on the machine."""

import os
import subprocess
import sys
import time

import pytest
import torch
from two_view_pose.pose_estimator import inference as inference_module
from two_view_pose.pose_estimator.cores import available_cores, idle_cores
from two_view_pose.pose_estimator.inference import Inference
from two_view_pose.pose_estimator.networks import PoseNetworks
from two_view_pose.pose_estimator.thread_pools import shared_pool, single_core_threads


def test_each_thread_computes_on_one_core_and_the_callers_stay_as_they_were():
    before = torch.get_num_threads()
    pool = single_core_threads(3)

    def compute(number: int) -> int:
        torch.ones(2**20).add_(number).sum()  # enough to be shared among cores
        return torch.get_num_threads()

    assert list(pool.map(compute, range(12))) == [1] * 12
    assert torch.get_num_threads() == before
    pool.shutdown()


def test_a_pool_is_kept():
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


def test_one_item_takes_idle_cores_and_no_others(networks: PoseNetworks, monkeypatch):
    """Alone it runs in the caller's thread; beside other work, or with others, in single ones."""
    inference = Inference(networks, threads=2)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    used = []

    class Pool:
        @staticmethod
        def map(work, items):
            used.append(len(items))
            return map(work, items)

    monkeypatch.setattr(inference_module, "shared_pool", lambda threads: Pool)
    for idle, items, expected in ((2, "a", []), (1, "a", [1]), (2, "ab", [2])):
        used.clear()
        monkeypatch.setattr(inference_module, "idle_cores", lambda idle=idle: idle)
        assert inference.in_batches(lambda batch: [x.upper() for x in batch], items) == [
            x.upper() for x in items
        ]
        assert used == expected
