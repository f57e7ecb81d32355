"""Workers are replaced where they hold too much or die, and nobody sees it in the data."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
import workers
from small_sets import apes, file_bytes
from two_view_pose.envs import worker_pool
from two_view_pose.envs.generate import GenerateConfig, generate


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> GenerateConfig:
    return apes(tmp_path_factory.mktemp("data") / "set", scenes=4)


def test_a_worker_that_holds_too_much_is_replaced(
    config: GenerateConfig, tmp_path: Path, monkeypatch
) -> None:
    replaced = []
    fresh = worker_pool._replace
    monkeypatch.setattr(worker_pool, "_replace", lambda *a: replaced.append(1) or fresh(*a))
    small = replace(config, out=tmp_path / "set", scenes=3, workers=2, worker_memory=1e-3)
    generate(small)
    assert replaced  # nothing runs in a megabyte
    for scene in ("000000", "000001", "000002"):
        one, other = (c.out / c.split / scene for c in (config, small))
        assert file_bytes(one) == file_bytes(other)


def test_a_worker_that_is_killed_is_replaced(config: GenerateConfig, tmp_path: Path) -> None:
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


def test_a_scene_whose_workers_always_die_ends_the_run(config: GenerateConfig, monkeypatch) -> None:
    spawn = multiprocessing.get_context("spawn")
    monkeypatch.setattr(worker_pool, "_new_worker", lambda _: ProcessPoolExecutor(1, spawn))
    monkeypatch.setattr(worker_pool, "make_one", workers.die)
    with pytest.raises(ChildProcessError, match="3 workers died on scene 8"):
        list(worker_pool.make_scenes(replace(config, workers=1), [8]))


def test_memory_is_what_this_process_holds() -> None:
    before = worker_pool.memory_in_use()
    ballast = bytearray(os.urandom(1) * 200_000_000)
    assert 150e6 < worker_pool.memory_in_use() - before < 400e6
    assert len(ballast) == 200_000_000


def test_a_limit_below_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="worker_memory must be at least 0 GB, got -1"):
        GenerateConfig(tmp_path, worker_memory=-1.0)
