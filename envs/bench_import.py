"""How long importing this package takes, beside Gymnasium, which it needs anyway."""

from __future__ import annotations

import subprocess
import sys

from ..pose_estimator.stopwatch import WARM_UP, Record, make_record

MOST = 1.2
"""Times Gymnasium's that ours may take."""

_SCRIPT = """
import time
start = time.perf_counter()
import {module}
print(time.perf_counter() - start)
"""


def compare_imports(repeats: int) -> list[Record]:
    """``import two_view_pose`` against ``import gymnasium``, each in a fresh process, in turn."""
    modules = (__name__.split(".")[0], "gymnasium")
    rounds = [[seconds_of_import(m) for m in modules] for _ in range(repeats + WARM_UP)][WARM_UP:]
    ours, theirs = zip(*rounds, strict=True)
    return [
        make_record(
            f"import {modules[0]}", f"import {modules[1]}", [*ours], [*theirs], goal=1 / MOST
        )
    ]


def seconds_of_import(module: str) -> float:
    """Seconds that importing a module takes in a fresh process, without Python's own start."""
    command = [sys.executable, "-c", _SCRIPT.format(module=module)]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    return float(answer.stdout.split()[-1])
