"""Kills and resumes a command at random moments, and checks what it leaves."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from kills.cases import Case


class Lost(AssertionError):
    """A kill or a full disk changed what a command leaves."""


def kill_and_resume(
    case: Case,
    root: Path,
    kills: int,
    seed: int = 0,
    say: Callable[[str], None] = lambda text: None,
) -> int:
    """Runs a command once without kills, then again and again with ``kills`` kills.

    A kill comes after a random time or number of files, to the process group or the parent alone.

    Args:
        case: the command.
        root: an empty working folder.
        kills: number of kills.
        seed: of their moments.
        say: is given a line for each run that ends.

    Returns:
        How many runs finished, each with the same contents as the undisturbed one.

    Raises:
        Lost: if a file is incomplete or different, or a run fails.
    """
    rng = random.Random(seed)
    expected, duration = prepare(case, root)
    out, done, finished = root / "disturbed", 0, 0
    while True:
        seconds = rng.uniform(0, duration)
        entries = rng.randint(_count(out), max(_count(out), _count(root / "reference")))
        by_entries, whole_group = rng.random() < 0.5, rng.random() < 0.7

        def due(
            passed: float,
            seconds: float = seconds,
            entries: int = entries,
            count: bool = by_entries,
        ) -> bool:
            return _count(out) > entries if count else passed > seconds

        last = done == kills
        code, text = run_case(
            case, root, out, None if last else due, os.killpg if whole_group else os.kill
        )
        if code is None:
            done += 1
            if case.by_files:
                for name, digest in case.contents(out).items():
                    if digest != expected.get(name):
                        raise Lost(f"{name} is incomplete or does not belong, after kill {done}")
            continue
        if code != 0:
            raise Lost(f"exit code {code} after kill {done}: {text[-2000:]}")
        finished += 1
        compare(case, out, expected, f"after kill {done}")
        say(f"{done} kills, {finished} runs finished, each equal to the undisturbed one")
        if last:
            return finished
        shutil.rmtree(out)


def prepare(case: Case, root: Path) -> tuple[dict[str, str], float]:
    """Makes a command's input, runs it undisturbed; returns its contents and its seconds."""
    for number, options in enumerate(case.needs):
        code, text = run_case(Case(options, case.contents), root, root / f"input-{number}")
        if code != 0:
            raise Lost(f"the input cannot be made: {text[-2000:]}")
    start = time.monotonic()
    code, text = run_case(case, root, root / "reference")
    if code != 0:
        raise Lost(f"the undisturbed run ends with {code}: {text[-2000:]}")
    expected = dict(case.contents(root / "reference"))
    if not expected:
        raise Lost("the undisturbed run leaves nothing to compare")
    return expected, time.monotonic() - start


def compare(case: Case, out: Path, expected: dict[str, str], when: str) -> None:
    """Raises Lost if a command's contents are not the expected ones."""
    found = dict(case.contents(out))
    if found != expected:
        names = [n for n in {**expected, **found} if found.get(n) != expected.get(n)]
        raise Lost(f"{', '.join(names[:5])} differ {when}")


def run_case(
    case: Case,
    root: Path,
    out: Path,
    due: Callable[[float], bool] | None = None,
    kill: Callable[[int, int], None] = os.kill,
) -> tuple[int | None, str]:
    """Runs a command until it ends or a kill is due; its exit code, None if killed, and output."""
    options = case.options.format(out=out, data=root / "input").split()
    command = [sys.executable, "-m", "two_view_pose", *options]
    start, log = time.monotonic(), root / "output.txt"
    with log.open("w") as output:
        process = subprocess.Popen(command, start_new_session=True, stdout=output, stderr=output)
        while process.poll() is None:
            if due is not None and due(time.monotonic() - start):
                kill(process.pid, signal.SIGKILL)
                process.wait()
                return None, ""
            time.sleep(0.005)
    return process.returncode, log.read_text(errors="replace")


def _count(folder: Path) -> int:
    """Returns the number of files and folders below a folder, temporary ones included."""
    return sum(len(folders) + len(files) for _, folders, files in os.walk(folder))
