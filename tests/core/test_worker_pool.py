"""Workers are replaced where they hold too much or die, and nobody sees it in the data."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from helpers.scene_tasks import DyingTask, ProcessTask
from helpers.small_sets import apes, file_bytes
from two_view_pose.core.worker_pool import memory_in_use, run_scenes
from two_view_pose.envs.datagen.generate import GenerateConfig, generate

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("limit", "replaced"), [(1e-3, True), (0.0, False), (1e3, False)])
def test_a_worker_above_the_memory_limit_is_replaced(
    tmp_path: Path, limit: float, replaced: bool
) -> None:
    made = list(run_scenes(partial(ProcessTask, tmp_path), range(5), 2, worker_memory=limit))
    assert sorted(made) == list(range(5))
    processes, threads = zip(*((tmp_path / str(i)).read_text().split() for i in made), strict=True)
    assert (len(set(processes)) == 5) == replaced
    assert set(threads) == {"1"} and os.getpid() not in map(int, processes)


def test_one_worker_is_this_process(tmp_path: Path) -> None:
    assert list(run_scenes(partial(ProcessTask, tmp_path), [3, 1], workers=1)) == [3, 1]
    assert (tmp_path / "3").read_text().split()[0] == str(os.getpid())


def test_a_worker_that_is_killed_is_replaced(tmp_path: Path) -> None:
    config = apes(tmp_path / "once", scenes=4)
    again = replace(config, out=tmp_path / "set", workers=2)
    killed = []

    def kill_one() -> None:
        while not list(again.out.glob("train_pbr/.*.partial")):
            time.sleep(0.01)
        victim = multiprocessing.active_children()[0].pid
        os.kill(victim, signal.SIGKILL)
        killed.append(victim)

    thread = threading.Thread(target=kill_one, daemon=True)
    thread.start()
    generate(again)
    thread.join()
    assert killed
    assert file_bytes(again.out) == file_bytes(config.out)


def test_a_scene_whose_workers_always_die_ends_the_run() -> None:
    with pytest.raises(ChildProcessError, match=r"3 workers died on scene [89]"):
        list(run_scenes(DyingTask, [8, 9], workers=2))


def test_memory_in_use_measures_this_process() -> None:
    before = memory_in_use()
    ballast = bytearray(os.urandom(1) * 200_000_000)
    assert 150e6 < memory_in_use() - before < 400e6
    assert len(ballast) == 200_000_000


def test_a_limit_below_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="worker_memory must be >= 0, got -1"):
        GenerateConfig(tmp_path, worker_memory=-1.0)
