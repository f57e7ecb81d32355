"""``python tests/kills``: kills commands at random moments and fills their disks.

A command that resumes must leave the same as one that was never stopped.
"""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

import tyro  # noqa: E402

from kills.cases import CASES  # noqa: E402
from kills.full_disk import fill_and_resume  # noqa: E402
from kills.kill_and_resume import Lost, kill_and_resume  # noqa: E402


@dataclass(frozen=True)
class KillConfig:
    """Kills commands at random moments, fills their disks, and compares what they leave."""

    cases: tuple[str, ...] = tuple(CASES)
    """Which commands."""
    kills: int = 40
    """Kills of each command."""
    disks: int = 5
    """How often the disk of each command is full; needs root on Linux. 0 = never."""
    seed: int = 0
    """Random seed of the moments."""


def main(config: KillConfig) -> int:
    """Runs the cases; returns 1 if one of them lost something."""
    failed = []
    for name in config.cases:
        case = CASES[name]
        try:
            with tempfile.TemporaryDirectory() as folder:
                runs = kill_and_resume(
                    case, Path(folder), config.kills, config.seed, lambda text: print(f"  {text}")
                )
            print(f"{name}: {config.kills} kills, {runs} runs finished, all equal", flush=True)
            if config.disks:
                with tempfile.TemporaryDirectory() as folder:
                    full = fill_and_resume(
                        case, Path(folder), config.disks, config.seed,
                        lambda text: print(f"  {text}", flush=True),
                    )  # fmt: skip
                print(f"{name}: {full} full disks, all resumed, all equal", flush=True)
        except Lost as error:
            print(f"{name}: {error}", flush=True)
            failed.append(name)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(KillConfig, prog="python tests/kills")))
