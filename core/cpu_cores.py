"""The processor's cores, and what Linux says of them."""

from __future__ import annotations

import os
from pathlib import Path

_CPUINFO = Path("/proc/cpuinfo")


def cpuinfo() -> dict[str, str]:
    """What Linux says of the first core; empty elsewhere."""
    try:
        lines = _CPUINFO.read_text().split("\n\n")[0].splitlines()
    except OSError:
        return {}
    pairs = (line.partition(":") for line in lines)
    return {key.strip(): value.strip() for key, _, value in pairs}


def available_cores() -> int:
    """Cores that this process may use, which a container may have fewer of than the machine."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def idle_cores() -> int:
    """Cores that this process may use and no other process does just now; at least 1.

    Where the system does not tell what runs (anywhere but on Linux), all cores count as idle.
    """
    try:
        running = int(Path("/proc/loadavg").read_text().split()[3].split("/")[0])
        own = sum(map(_runs, Path("/proc/self/task").iterdir()))
    except (OSError, IndexError, ValueError):
        return available_cores()
    others = max(0, running - own)
    return max(1, min(available_cores(), (os.cpu_count() or 1) - others))


def _runs(thread: Path) -> bool:
    """Whether a thread of this process runs now; one that just ended does not."""
    try:
        return (thread / "stat").read_text().rpartition(")")[2].split()[0] == "R"
    except OSError:
        return False
