"""Kills and resumes ``generate`` at random moments, and checks the files that are left.

After each SIGKILL (of the process group, or of the parent alone), every file with a final name must
have the bytes of an undisturbed run. When a run finishes, both datasets must be equal.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from helpers.small_sets import file_bytes

OPTIONS = "--views 2 --objects ape duck --width 160 --height 120 --depth --coco --split test"


def kill_and_resume(root: Path, kills: int, scenes: int, workers: int, seed: int = 0) -> int:
    """Renders a dataset once without kills, then again with ``kills`` kills.

    Args:
        root: an empty working folder.
        kills: number of kills.
        scenes: of the dataset.
        workers: rendering processes.
        seed: of the moments of the kills.

    Returns:
        How many runs finished, each with the same bytes as the undisturbed one.

    Raises:
        AssertionError: if a file is incomplete or different.
    """
    rng = random.Random(seed)
    reference, disturbed = root / "reference", root / "disturbed"
    options = [*OPTIONS.split(), "--scenes", str(scenes), "--workers", str(workers)]
    start = time.monotonic()
    assert _generate(reference, options) == 0
    duration = time.monotonic() - start
    expected = file_bytes(reference)
    done = finished = 0
    while done < kills:
        seconds = rng.uniform(0, duration)
        entries = rng.randint(_count(disturbed), _count(reference))
        by_entries, whole_group = rng.random() < 0.7, rng.random() < 0.5

        def due(
            passed: float,
            seconds: float = seconds,
            entries: int = entries,
            count: bool = by_entries,
        ) -> bool:
            return _count(disturbed) > entries if count else passed > seconds

        if _generate(disturbed, options, due, os.killpg if whole_group else os.kill) is None:
            done += 1
            for path, data in file_bytes(disturbed).items():
                if not any(part.startswith(".") for part in path.parts):  # not a temporary name
                    assert data == expected.get(path), f"{path} is incomplete or does not belong"
        else:
            finished += 1
            assert file_bytes(disturbed) == expected
            shutil.rmtree(disturbed)
    assert _generate(disturbed, options) == 0
    assert file_bytes(disturbed) == expected
    assert _generate(disturbed, ["--verify"]) == 0
    return finished + 1


def _generate(
    out: Path,
    options: list[str],
    due: Callable[[float], bool] = lambda passed: False,
    kill: Callable[[int, int], None] = os.kill,
) -> int | None:
    """Runs ``generate`` until it ends or a kill is due; returns the exit code, None if killed."""
    command = [sys.executable, "-m", "two_view_pose", "generate", "--out", str(out), *options]
    start, null = time.monotonic(), subprocess.DEVNULL
    process = subprocess.Popen(command, start_new_session=True, stdout=null, stderr=null)
    while process.poll() is None:
        if due(time.monotonic() - start):
            kill(process.pid, signal.SIGKILL)
            process.wait()
            return None
        time.sleep(0.005)
    return process.returncode


def _count(folder: Path) -> int:
    """Returns the number of files and folders below a folder, temporary ones included."""
    return sum(len(folders) + len(files) for _, folders, files in os.walk(folder))
