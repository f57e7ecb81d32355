"""The verb ``bench``: how quick things are (and how robust), as ratios to what others would use.

Machines differ and drift, so both sides of a ratio take turns in one run, and medians count. Each
group of comparisons has a process of its own, so that no library disturbs another's. Every line is
told and written as soon as it is measured; a run that was interrupted goes on with the same
command.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..pose_estimator.stopwatch import Missing, Record
    from .bench_kept import Measured

GROUPS = {
    "rendering": "RGB, depth and masks, against mujoco.Renderer",
    "pyrender": "the same, and all annotations, against pyrender",
    "pixels": "steps and episodes of pixels, against Gymnasium's renderer and dm_control",
    "vector": "eight lanes, against as many single environments in sequence",
    "estimator": "Mid-Fusion and a step, against PVNet and ResNet-18",
    "busy": "an estimate, lanes and training beside busy processes, against the same alone",
    "network": "the 3D network's operations, against a large matrix product",
    "solver": "Soft RANSAC, against the RANSACs of OpenCV and Open3D",
    "metrics": "ADD-S, against the BOP toolkit's way",
    "import": "importing the package, against importing Gymnasium",
    "generate": "pictures a second of the generator",
    "cost": "cost against size, which --figure draws",
}
"""What --only chooses from, in the order in which they run."""

_WIDTH = 150
"""Of the table in characters, where it is not printed in a terminal."""


@dataclass(frozen=True)
class BenchConfig:
    """Times our work against what people would use instead, in one run."""

    repeats: int = 15
    """Timed repeats of each side; the median counts."""
    only: tuple[str, ...] = ()
    """Groups to run: rendering, pyrender, pixels, vector, estimator, busy, network, solver,
    metrics, import, generate, cost. None named: all of them."""
    weights: str | None = "linemod"
    """Weights of the estimator; None leaves out what needs them."""
    scenes: int = 26
    """Scenes of four pictures that the generator makes on two workers; 0 leaves that out."""
    soak: int = 0
    """Measure nothing but memory, over so many steps of the environment."""
    seed: int = 0
    """Of scenes, poses and actions."""
    json: Path | None = None
    """Results file, which holds each ratio as soon as it is measured. If it is that of an
    interrupted run with the same options, processor and code, the run goes on there."""
    markdown: Path | None = None
    """Write the table as Markdown."""
    figure: Path | None = None
    """Draw cost against size into this PNG."""
    pictures: Path | None = None
    """Also write both renderers' pictures, side by side, to this PNG."""

    def __post_init__(self) -> None:
        for group in self.only:
            if group not in GROUPS:
                raise ValueError(f"only must name some of {', '.join(GROUPS)}, got {group!r}")
        if self.repeats < 1:
            raise ValueError(f"repeats must be at least 1, got {self.repeats}")
        if self.figure is not None and "cost" not in self.groups:
            raise ValueError("figure is drawn from the group cost, which is not among those to run")

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups to run."""
        if self.soak:
            return ()
        without = set() if self.scenes else {"generate"}
        if self.weights is None:
            without |= {"vector", "estimator", "busy", "cost"}
        if not (self.only or self.json or self.figure):
            without.add("cost")  # it is in no table
        return tuple(g for g in GROUPS if g in (self.only or GROUPS) and g not in without)


def bench(config: BenchConfig) -> None:
    """Runs the comparisons and prints them."""
    # MuJoCo's own renderer decides on its back-end when it is imported, and prefers a window.
    os.environ.setdefault("MUJOCO_GL", "egl")
    from rich.console import Console

    from ..pose_estimator.results import write_atomically
    from .bench_kept import Measured, conditions
    from .bench_table import markdown, table

    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDTH)
    measured = Measured(
        config.json,
        config.seed,
        conditions(
            repeats=config.repeats,
            weights=config.weights,
            scenes=config.scenes,
            soak=config.soak,
            groups=",".join(config.groups),
        ),
    )
    _say(console, f"on {measured.conditions['processor']}")
    _say(console, measured.resume(config.groups))
    for number, group in enumerate(config.groups, start=1):
        title = f"{number}/{len(config.groups)} {group}: {GROUPS[group]}"
        if measured.finished(group):
            _say(console, f"{title}: measured already")
        else:
            _say(console, title)
            with console.status(title):
                measure_group(group, config, measured, console)
    if config.soak:
        from .bench_memory import measure_memory

        for line in measure_memory(config.soak, config.seed):
            measured.add("memory", line)
    console.print(table(measured.records))
    for missing in measured.missing():
        _say(console, str(missing))
    if config.markdown is not None:
        write_atomically(config.markdown, markdown(measured.records).encode())
    if config.figure is not None:
        from .bench_cost import draw_costs

        draw_costs(config.figure, measured.records)


def measure_group(group: str, config: BenchConfig, measured: Measured, console: Any) -> None:
    """Measures one group in a process of its own; tells and keeps each line as it comes."""
    from ..pose_estimator.stopwatch import Missing, each_from_own_process
    from .bench_table import one_line

    started = perf_counter()
    for line in each_from_own_process(run_group, group, config):
        measured.add(group, line)
        _say(console, f"  {line if isinstance(line, Missing) else one_line(line)}")
    measured.finish(group, perf_counter() - started)


def _say(console: Any, text: str) -> None:
    if text:
        console.print(text, markup=False, highlight=False)


def run_group(group: str, config: BenchConfig) -> Iterator[Record | Missing]:
    """One of ``GROUPS``; imports only what it needs."""
    repeats, seed = config.repeats, config.seed
    if group == "rendering":
        from .bench_rendering import compare_renderers

        yield from compare_renderers(repeats, seed, config.pictures)
    elif group == "pyrender":
        from .bench_pyrender import compare_with_pyrender

        yield from compare_with_pyrender(repeats, seed)
    elif group == "pixels":
        from .bench_pixels import compare_pixels

        yield from compare_pixels(repeats, seed)
    elif group == "import":
        from .bench_import import compare_imports

        yield from compare_imports(repeats)
    elif group == "generate":
        from .bench_generator import measure_generator

        yield from measure_generator(config.scenes, seed)
    elif group in ("network", "solver", "metrics"):
        yield from run_estimator_group(group, repeats, seed)
    else:
        assert config.weights is not None
        yield from run_group_with_weights(group, config.weights, repeats, seed)


def run_group_with_weights(
    group: str, weights: str, repeats: int, seed: int
) -> Iterator[Record | Missing]:
    """One of the groups that ask a trained estimator."""
    if group == "vector":
        from .bench_vector import compare_vector

        yield from compare_vector(weights, repeats, seed)
    elif group == "estimator":
        from .bench_estimator import compare_estimates

        yield from compare_estimates(weights, repeats, seed)
    elif group == "busy":
        from .bench_busy import compare_busy

        yield from compare_busy(weights, repeats, seed)
    else:
        from .bench_cost import measure_costs

        yield from measure_costs(weights, repeats, seed)


def run_estimator_group(group: str, repeats: int, seed: int) -> Iterator[Record | Missing]:
    """One of the groups that need nothing of the environment."""
    if group == "network":
        from ..pose_estimator.bench_network import compare_networks

        yield from compare_networks(repeats)
    elif group == "solver":
        from ..pose_estimator.bench_solver import compare_robustness, compare_speed

        yield from compare_speed(repeats, seed)
        yield compare_robustness(seed)
    else:
        from .. import assets
        from ..pose_estimator.bench_metrics import compare_add_s

        models = assets.load_objects(None).items()
        yield compare_add_s({name: m for name, m in models if m.symmetric}, repeats, seed)
