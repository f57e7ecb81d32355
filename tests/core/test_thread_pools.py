"""Threads on one core each, and what else runs on the machine."""

import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import torch
from two_view_pose.core.cpu_cores import available_cores, idle_cores
from two_view_pose.core.thread_pools import shared_pool, single_core_threads
from two_view_pose.pose_estimator.networks import inference as inference_module
from two_view_pose.pose_estimator.networks.inference import Inference


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


@pytest.mark.parametrize("same", [True, False])
def test_single_items_use_all_cores_only_if_bit_equal(networks, monkeypatch, same):
    """An item is computed in the caller's thread, on all its cores, or in one of the pool's."""
    inference = Inference(networks, threads=2)
    callers = threading.get_ident()
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    places: list[str] = []

    def work(items):
        here = threading.get_ident() == callers
        places.append("all cores" if here else "one core")
        answer = np.ones(3) + (0 if same else 1e-9 * here)
        return [(answer, torch.ones(2, dtype=torch.bfloat16)) for _ in items]

    def asked(items: str, idle: int, kind: str | None) -> list[str]:
        monkeypatch.setattr(inference_module, "idle_cores", lambda: idle)
        places.clear()
        answers = inference.in_batches(work, items, kind=kind)
        assert len(answers) == len(items)
        assert all(np.array_equal(a, answers[0][0]) for a, _ in answers)
        return places

    assert asked("a", 2, "frame") == ["one core", "all cores"]  # the first time: both ways
    assert asked("a", 2, "frame") == ["all cores" if same else "one core"]
    assert asked("a", 1, "frame") == ["one core"]  # the machine is busy
    assert asked("ab", 2, "frame") == ["one core"] * 2
    assert asked("a", 2, None) == ["one core"]
