"""Runs inputs in a worker process, and counts how they end."""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from .judge import READ, REFUSED, End, Reader

WALL_SECONDS = 90
"""Until a worker that waits for something is ended."""

_FRAME = re.compile(r'two_view_pose/(\S+)", line (\d+)')


class Worker:
    """A worker process, started again after it has died."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def run(self, reader: str, number: int | None, keep: Path | None = None) -> End:
        """Runs one input; None: the valid files."""
        if self._process is None:
            self._start()
        process = self._process
        assert process is not None and process.stdin is not None and process.stdout is not None
        request = {"reader": reader, "number": number, "keep": str(keep) if keep else None}
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        ready, _, _ = select.select([process.stdout], [], [], WALL_SECONDS)
        line = process.stdout.readline() if ready else ""
        if line:
            return End(**json.loads(line))
        if not ready:
            process.kill()
        code = process.wait()
        errors = self.close()
        return End("hang" if code == -27 or not ready else "crash", f"exit {code}\n{errors}")

    def _start(self) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "fuzz.worker"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=self._errors, text=True, env=environment,
        )  # fmt: skip

    def close(self) -> str:
        """Ends the process; returns the end of what it wrote to standard error."""
        if self._process is None:
            return ""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdout.close()
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        self._process.wait()
        self._process = None
        self._errors.seek(0)
        text = self._errors.read()[-4000:]
        self._errors.close()
        return text


def check_valid_files(worker: Worker, name: str, reader: Reader) -> None:
    """Raises unless a reader reads the files that its damage begins with."""
    if reader.change is None:
        end = worker.run(name, None)
        if end.kind != READ:
            raise RuntimeError(f"the valid files of {name} are {end.kind}: {end.detail}")


@dataclass
class Tally:
    """How the inputs of one reader ended.

    Attributes:
        ends: their number by kind.
        findings: place -> number and detail of its first input.
        places: place -> number of inputs.
    """

    ends: Counter[str] = field(default_factory=Counter)
    findings: dict[str, tuple[int, str]] = field(default_factory=dict)
    places: Counter[str] = field(default_factory=Counter)

    def add(self, number: int, end: End) -> None:
        self.ends[end.kind] += 1
        if not end.good:
            place = f"{end.kind} {_place(end.detail)}"
            self.places[place] += 1
            self.findings.setdefault(place, (number, end.detail))

    def report(self, reader: str) -> str:
        """Lines for people."""
        total = sum(self.ends.values())
        good = f"{self.ends[REFUSED]} refused, {self.ends[READ]} read"
        lines = [f"{reader}: {total} inputs, {good}, {total - self.good} wrong"]
        for place, (number, detail) in self.findings.items():
            lines += [f"  {self.places[place]} x {place}", f"    {repeat(reader, number)}"]
            lines += [f"    | {line}" for line in detail.strip().splitlines()[-12:]]
        return "\n".join(lines)

    @property
    def good(self) -> int:
        return self.ends[REFUSED] + self.ends[READ]


def repeat(reader: str, number: int) -> str:
    """The command that runs one input again."""
    return f"python tests/fuzz --reader {reader} --seed {number} --inputs 1"


def _place(detail: str) -> str:
    """Where in the package an error arose, and of which type: equal ones are one finding."""
    frames = [f"{file}:{line}" for file, line in _FRAME.findall(detail)]
    last = (detail.strip().splitlines() or [""])[-1]
    words = re.match(r"[\w.: ]*", re.sub(r"[0-9]+", "#", last))
    return f"{frames[-1] if frames else ''} {words[0][:60] if words else ''}".strip()
