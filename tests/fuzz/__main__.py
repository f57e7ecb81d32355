"""``python tests/fuzz``: gives damaged files to every reader for an hour.

Exits with 1 where one of them ended in a traceback, a crash, a hang, too much memory, a value that
is not valid, or a message that names no file.
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

import tyro  # noqa: E402

from fuzz.campaign import Tally, Worker, check_valid_files  # noqa: E402
from fuzz.readers import READERS  # noqa: E402


@dataclass(frozen=True)
class FuzzConfig:
    """Gives damaged files to readers, and prints how they end and how to repeat what is wrong."""

    reader: tuple[str, ...] = tuple(READERS)
    """Which readers."""
    minutes: float = 60.0
    """How long, all readers together; each gets an equal part."""
    inputs: int = 0
    """Inputs of each reader; 0 = until the time is over."""
    seed: int = 0
    """Number of the first input of each reader."""
    keep: Path | None = None
    """Folder for the damaged files of wrong inputs."""


def main(config: FuzzConfig) -> int:
    """Runs the readers; returns 1 if one of them was wrong."""
    worker, wrong = Worker(), 0
    share = 60 * config.minutes / max(1, len(config.reader))
    for name in config.reader:
        check_valid_files(worker, name, READERS[name])
        tally, number, start = Tally(), config.seed, time.monotonic()
        while time.monotonic() - start < share:
            end = worker.run(name, number)
            tally.add(number, end)
            if not end.good and config.keep is not None:
                worker.run(name, number, config.keep / f"{name}-{number}")
            number += 1
            if number - config.seed == config.inputs:
                break
        print(tally.report(name), flush=True)
        wrong += len(tally.findings)
    worker.close()
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(FuzzConfig, prog="python tests/fuzz")))
