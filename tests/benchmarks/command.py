"""``python tests/benchmarks``: speed and robustness, as ratios to alternatives.

Both sides of a ratio take turns in one run, because machines drift, and medians count. Each group
of comparisons runs in its own process, which isolates the state of the libraries. Every record is
printed and written as soon as it is measured; the same command resumes an interrupted run.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from time import perf_counter

import tyro
from rich.console import Console
from two_view_pose.core.files import write_atomically

from .config import GROUPS, BenchConfig
from .own_process import each_from_own_process
from .results_file import ResultsFile, conditions
from .stopwatch import MISSING, Record
from .table import markdown, one_line, table

_WIDTH = 150
"""Width of the table in characters, if the output is not a terminal."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns 0, 2 (wrong input) or 130 (interrupted)."""
    try:
        bench(tyro.cli(BenchConfig, prog="python tests/benchmarks", args=arguments))
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    return 0


def bench(config: BenchConfig) -> None:
    """Runs the comparisons and prints them."""
    # MuJoCo's renderer selects its back-end when it is imported, and prefers a window.
    os.environ.setdefault("MUJOCO_GL", "egl")
    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDTH)

    def say(text: str) -> None:
        if text:
            console.print(text, markup=False, highlight=False)

    names = ("repeats", "weights", "scenes", "soak")
    options = {name: getattr(config, name) for name in names}
    measured = ResultsFile(
        config.json, config.seed, conditions(**options, groups=",".join(config.groups))
    )
    say(f"on {measured.conditions['processor']}")
    say(measured.resume(config.groups))
    for number, group in enumerate(config.groups, start=1):
        title = f"{number}/{len(config.groups)} {group}: {GROUPS[group].summary}"
        if measured.finished(group):
            say(f"{title}: already measured")
            continue
        say(title)
        started = perf_counter()
        with console.status(title):
            for line in each_from_own_process(run_group, group, config):
                measured.add(group, line)
                say(f"  {one_line(line)}")
        measured.finish(group, perf_counter() - started)
    if config.soak:
        from .groups.memory import measure_memory

        for record in measure_memory(config.soak, config.seed):
            measured.add("memory", record)
    console.print(table(measured.records))
    for record in measured.records:
        if record["metric"] == MISSING:
            say(one_line(record))
    if config.markdown is not None:
        write_atomically(config.markdown, markdown(measured.records).encode())
    if config.figure is not None:
        from .groups.cost import draw_costs

        draw_costs(config.figure, measured.records)


def run_group(group: str, config: BenchConfig) -> Iterator[Record]:
    """One of ``GROUPS``; imports only what it needs."""
    yield from import_module(f".groups.{GROUPS[group].module}", __package__).measure(config)
