"""Free memory between what is in use goes back to the system."""

from __future__ import annotations

import gymnasium as gym
import pytest
import two_view_pose  # noqa: F401
from two_view_pose.envs import freed_memory
from two_view_pose.envs.worker_pool import memory_in_use


@pytest.mark.skipif(freed_memory._malloc_trim() is None, reason="GNU's allocator only")
def test_holes_are_given_back():
    blocks = [bytes(bytearray(50_000)) for _ in range(4_000)]  # 200 MB, too small for maps
    kept = blocks[::40]
    full = memory_in_use()
    del blocks
    assert freed_memory.give_back()
    assert full - memory_in_use() > 120e6
    assert all(not any(block) for block in kept)


def test_environments_give_back_now_and_then(monkeypatch):
    given = []
    monkeypatch.setattr(freed_memory, "give_back", lambda: given.append(1))
    monkeypatch.setattr(freed_memory, "EPISODES", 3)
    with gym.make("TwoViewPose-v0", estimator=None) as env:
        for seed in range(7):
            env.reset(seed=seed)
    assert len(given) == 2


def test_other_c_libraries_are_left_alone(monkeypatch):
    monkeypatch.setattr(freed_memory, "_malloc_trim", lambda: None)
    assert not freed_memory.give_back()
