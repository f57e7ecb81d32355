"""Fills the disk while a command runs, and checks that it says so, and resumes with room again."""

import os
import random
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from kills.cases import Case
from kills.kill_and_resume import Lost, compare, prepare, run_case

_ROOM = 4096
"""Smallest room in bytes that is left."""


def fill_and_resume(
    case: Case,
    root: Path,
    times: int,
    seed: int = 0,
    say: Callable[[str], None] = lambda text: None,
) -> int:
    """Runs a command on a small disk that fills up, then with room again; needs root on Linux.

    Args:
        case: the command.
        root: an empty working folder.
        times: how often, each with another room.
        seed: of the room.
        say: is given a line for each time.

    Returns:
        How often the disk was full before the command had ended.

    Raises:
        Lost: if something that was finished is lost, the error does not name the disk, or the
            resumed run leaves something else.
        OSError: if no disk can be mounted here.
    """
    rng = random.Random(seed)
    expected, _ = prepare(case, root)
    size = sum(path.stat().st_size for path in (root / "reference").rglob("*") if path.is_file())
    full = 0
    for number in range(times):
        room = max(_ROOM, int(size * rng.uniform(0, 1.6)))
        with small_disk(root / "disk", 3 * size + (1 << 20)) as disk:
            filler, out = disk / "filler", disk / "out"
            free = os.statvfs(disk)
            with filler.open("wb") as file:
                file.write(bytes(max(0, free.f_bavail * free.f_frsize - room)))
            code, text = run_case(case, root, out)
            if code == 0:
                compare(case, out, expected, f"with {room} bytes of room")
                say(f"{number + 1}: {room} bytes were enough")
                continue
            full += 1
            message = text.strip().splitlines()[-1] if text.strip() else ""
            if "Traceback" in text or "space" not in message:
                raise Lost(f"with {room} bytes of room it ends with {code}: {text[-1500:]}")
            filler.unlink()
            code, text = run_case(case, root, out)
            if code != 0:
                raise Lost(f"with room again it ends with {code}: {text[-1500:]}")
            compare(case, out, expected, f"after a disk with {room} bytes of room")
            say(f"{number + 1}: full after {room} of {size} bytes, resumed; it said: {message}")
    return full


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Path]:
    """Mounts a disk in memory of ``size`` bytes.

    Raises:
        OSError: if that is not allowed.
    """
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True)
    if done.returncode:
        raise OSError(f"no small disk can be mounted here: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)
