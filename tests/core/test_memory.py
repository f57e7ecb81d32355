"""Free memory between what is in use goes back to the system."""

from __future__ import annotations

import platform

import pytest
from two_view_pose.core import memory
from two_view_pose.core.memory import release_unused_memory
from two_view_pose.core.worker_pool import memory_in_use


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="GNU's allocator only")
def test_unused_memory_is_released():
    blocks = [bytes(bytearray(50_000)) for _ in range(4_000)]  # 200 MB, too small for maps
    kept = blocks[::40]
    full = memory_in_use()
    del blocks
    assert release_unused_memory()
    assert full - memory_in_use() > 120e6
    assert all(not any(block) for block in kept)


def test_nothing_is_released_without_glibc(monkeypatch):
    monkeypatch.setattr(memory.sys, "platform", "darwin")
    assert not release_unused_memory()
