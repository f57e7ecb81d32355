"""CPU cores: available and idle ones, and /proc/cpuinfo."""

import os
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")


def cpuinfo() -> dict[str, str]:
    """/proc/cpuinfo of the first core; empty where there is none."""
    try:
        lines = CPUINFO.read_text().split("\n\n")[0].splitlines()
    except OSError:
        return {}
    pairs = (line.partition(":") for line in lines)
    return {key.strip(): value.strip() for key, _, value in pairs}


def available_cores() -> int:
    """Cores that this process may use; in a container possibly fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def idle_cores() -> int:
    """Available cores that no other process uses now, at least 1; all of them except on Linux."""
    try:
        running = int(Path("/proc/loadavg").read_text().split()[3].split("/")[0])
        own = sum(map(_runs, Path("/proc/self/task").iterdir()))
    except (OSError, IndexError, ValueError):
        return available_cores()
    others = max(0, running - own)
    return max(1, min(available_cores(), (os.cpu_count() or 1) - others))


def _runs(thread: Path) -> bool:
    """Whether a thread of this process is running."""
    try:
        return (thread / "stat").read_text().rpartition(")")[2].split()[0] == "R"
    except OSError:
        return False
