"""Runs the benchmarks from a checkout; see `command`."""

import sys
from pathlib import Path

# The files of this folder import each other as the package `benchmarks`, as they do in tests.
sys.path[0] = str(Path(__file__).resolve().parents[1])

from benchmarks.command import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
