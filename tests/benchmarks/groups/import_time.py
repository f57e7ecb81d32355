"""Import time of this package compared with Gymnasium, which it imports."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

from ..config import BenchConfig
from ..stopwatch import WARM_UP, Record, make_record

MAX_RATIO = 1.2
"""Times Gymnasium's that ours may take."""

_SCRIPT = """
import time
start = time.perf_counter()
import {module}
print(time.perf_counter() - start)
"""


def measure(config: BenchConfig) -> Iterator[Record]:
    """``import two_view_pose`` against ``import gymnasium``, each in a fresh process, in turn."""
    ours, theirs = modules = ("two_view_pose", "gymnasium")
    rounds = [[seconds_of_import(m) for m in modules] for _ in range(config.repeats + WARM_UP)]
    our_times, their_times = zip(*rounds[WARM_UP:], strict=True)
    goal = 1 / MAX_RATIO
    yield make_record(f"import {ours}", f"import {theirs}", our_times, their_times, goal)


def seconds_of_import(module: str) -> float:
    """Seconds that importing a module takes in a fresh process, without Python's own start."""
    command = [sys.executable, "-c", _SCRIPT.format(module=module)]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(answer.stdout.split()[-1])
