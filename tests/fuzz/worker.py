"""The process that reads damaged files: it may run out of memory or time, or crash.

Reads lines ``{"reader", "number", "keep"}`` and answers each with ``{"kind", "detail"}``; without a
number the files are not damaged.
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
from pathlib import Path

MEMORY = 2 * 2**30
"""Bytes of address space for one input, beyond what is used before it."""

SECONDS = 10
"""Of computing for one input; a busy machine does not count."""


def main() -> None:
    """Answers until its input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # readers print
    faulthandler.enable()
    # Prints where it hangs, then ends the process as this signal does.
    faulthandler.register(signal.SIGPROF, all_threads=True, chain=True)
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        os.environ["XDG_CACHE_HOME"] = str(root / "cache")
        from .readers import READERS

        for line in sys.stdin:
            request = json.loads(line)
            valid = root / "valid" / request["reader"]
            if not valid.is_dir():
                valid.mkdir(parents=True)
                READERS[request["reader"]].write(valid)
            print(json.dumps(_answer(request, valid, root / "input")), file=answers, flush=True)


def _answer(request: dict, valid: Path, folder: Path) -> dict[str, str]:
    from .judge import judge, make_input
    from .readers import READERS

    reader = READERS[request["reader"]]
    shutil.rmtree(folder, ignore_errors=True)
    if request["number"] is None:  # the valid files
        shutil.copytree(valid, folder)
        given = folder
    else:
        given = make_input(reader, request["reader"], valid, folder, request["number"])
    if request["keep"]:
        shutil.copytree(folder, request["keep"], dirs_exist_ok=True)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, hard))
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        end = judge(reader, given, folder)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
    return {"kind": end.kind, "detail": end.detail}


if __name__ == "__main__":
    main()
