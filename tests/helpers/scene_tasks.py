"""Tasks for a pool of workers, in a module that a spawned process imports quickly."""

from __future__ import annotations

import os
import signal
from pathlib import Path


class DyingTask:
    """Ends the process as a lack of memory would."""

    def make(self, scene_id: int) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    def close(self) -> None:
        pass


class ProcessTask:
    """Writes for each scene which process made it, and with how many threads it computes."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def make(self, scene_id: int) -> None:
        threads = os.environ.get("OMP_NUM_THREADS", "all")
        (self._folder / str(scene_id)).write_text(f"{os.getpid()} {threads}")

    def close(self) -> None:
        pass
