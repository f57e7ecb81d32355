"""Kills a run of ``generate`` again and again, and goes on with it, as a bad machine would.

``python tests/helpers/kill_and_resume.py --kills 20`` renders a small dataset once, undisturbed.
Then it renders it again, killed with SIGKILL at random: after so many seconds, or when there are
so many files; the whole group of processes, or the parent alone. After each kill, whatever stands
under a final name must hold the bytes that it has in the undisturbed dataset. Whenever a run gets
to its end, the two folders must be the same; then a new folder is begun, until all kills are done.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


def kill_and_resume(root: Path, kills: int, scenes: int, workers: int, seed: int = 0) -> list[str]:
    """Does what this file says.

    Args:
        root: an empty folder to work in.
        kills: how often to kill.
        scenes: of the dataset.
        workers: processes that render.
        seed: of the moments.

    Returns:
        A line for each kill and each finished dataset.

    Raises:
        AssertionError: if a file is not what it has to be.
    """
    rng = random.Random(seed)
    reference, disturbed = root / "reference", root / "disturbed"
    start = time.monotonic()
    assert _run(_command(reference, scenes, workers)) == 0
    duration = time.monotonic() - start
    expected = _files(reference)
    log = [f"undisturbed: {len(expected)} files in {duration:.1f} s"]
    done = 0
    while done < kills:
        moment = _Moment(disturbed, seconds=rng.uniform(0, duration))
        if rng.random() < 0.7:
            moment = _Moment(disturbed, entries=rng.randint(_count(disturbed), _count(reference)))
        everyone = rng.random() < 0.5
        if _run(_command(disturbed, scenes, workers), moment, everyone) is None:
            done += 1
            whole, hidden = _check_what_is_there(disturbed, expected)
            who = "all processes" if everyone else "the parent"
            log.append(
                f"kill {done}: {who} {moment}: {whole} of {len(expected)} files, all whole; "
                f"{hidden} under temporary names"
            )
        else:
            log.append(_finished(disturbed, expected))
            shutil.rmtree(disturbed)
        print(log[-1], flush=True)
    assert _run(_command(disturbed, scenes, workers)) == 0
    log.append(_finished(disturbed, expected))
    print(log[-1], flush=True)
    return log


def _command(out: Path, scenes: int, workers: int) -> list[str]:
    options = "--views 2 --objects ape duck --width 160 --height 120 --depth --coco --split test"
    sizes = ["--scenes", str(scenes), "--workers", str(workers)]
    command = [sys.executable, "-m", "two_view_pose", "generate", "--out", str(out)]
    return [*command, *options.split(), *sizes]


@dataclass
class _Moment:
    """When to kill: after so many seconds, or when there are more files and folders than that."""

    folder: Path
    seconds: float | None = None
    entries: int = 0

    def __str__(self) -> str:
        if self.seconds is not None:
            return f"after {self.seconds:.1f} s"
        return f"at more than {self.entries} entries"

    def has_come(self, passed: float) -> bool:
        if self.seconds is not None:
            return passed > self.seconds
        return _count(self.folder) > self.entries


def _run(
    command: Sequence[str], moment: _Moment | None = None, everyone: bool = True
) -> int | None:
    """Runs a command; the exit code, or None if it was killed."""
    start = time.monotonic()
    null = subprocess.DEVNULL
    process = subprocess.Popen(command, start_new_session=True, stdout=null, stderr=null)
    while process.poll() is None:
        if moment is not None and moment.has_come(time.monotonic() - start):
            (os.killpg if everyone else os.kill)(process.pid, signal.SIGKILL)
            process.wait()
            return None
        time.sleep(0.005)
    return process.returncode


def _count(folder: Path) -> int:
    """Files and folders below a folder, those under temporary names too."""
    return sum(len(folders) + len(files) for _, folders, files in os.walk(folder))


def _files(folder: Path) -> dict[str, bytes]:
    """The files of a folder that do not bear temporary names, nor lie in a folder that does."""
    names = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    shown = [name for name in names if not any(part.startswith(".") for part in name.parts)]
    return {str(name): (folder / name).read_bytes() for name in shown}


def _check_what_is_there(folder: Path, expected: dict[str, bytes]) -> tuple[int, int]:
    """Checks the files that a killed run left; how many, and how many under temporary names."""
    found = _files(folder)
    for name, data in found.items():
        assert name in expected, f"{name} does not belong there"
        assert data == expected[name], f"{name} is not whole"
    every = sum(path.is_file() for path in folder.rglob("*"))
    return len(found), max(0, every - len(found))


def _finished(folder: Path, expected: dict[str, bytes]) -> str:
    """Checks a dataset whose run got to its end."""
    found = {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
    assert found.keys() == expected.keys(), found.keys() ^ expected.keys()
    different = [name for name in found if found[name] != expected[name]]
    assert not different, different
    verify = [sys.executable, "-m", "two_view_pose", "generate", "--verify", "--out", str(folder)]
    assert _run(verify) == 0
    return f"finished: the same {len(found)} files to the byte, --verify agrees"


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--scenes", type=int, default=6)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        kill_and_resume(Path(folder), options.kills, options.scenes, options.workers, options.seed)


if __name__ == "__main__":
    main()
