"""The verb ``bench``: how quick things are (and how robust), as ratios to what others would use.

Machines differ and drift, so both sides of a ratio take turns in one run, and medians count. Each
group of comparisons has a process of its own, so that no library disturbs another's.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..pose_estimator.stopwatch import Missing, Record

GROUPS = {
    "rendering": "RGB, depth and masks, against mujoco.Renderer",
    "pyrender": "the same, and all annotations, against pyrender",
    "pixels": "steps and episodes of pixels, against Gymnasium's renderer and dm_control",
    "vector": "eight lanes, against as many single environments in sequence",
    "estimator": "Mid-Fusion and a step, against PVNet and ResNet-18",
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
    """Groups to run: rendering, pyrender, pixels, vector, estimator, network, solver, metrics,
    import, generate, cost. None named: all of them."""
    weights: str | None = "linemod"
    """Weights of the estimator; None leaves out what needs them."""
    scenes: int = 26
    """Scenes of four pictures that the generator makes on two workers; 0 leaves that out."""
    soak: int = 0
    """Measure nothing but memory, over so many steps of the environment."""
    seed: int = 0
    """Of scenes, poses and actions."""
    json: Path | None = None
    """Write the ratios as a results file."""
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
            without |= {"vector", "estimator", "cost"}
        if not (self.only or self.json or self.figure):
            without.add("cost")  # it is in no table
        return tuple(g for g in GROUPS if g in (self.only or GROUPS) and g not in without)


def bench(config: BenchConfig) -> None:
    """Runs the comparisons and prints them."""
    # MuJoCo's own renderer decides on its back-end when it is imported, and prefers a window.
    os.environ.setdefault("MUJOCO_GL", "egl")
    from rich.console import Console

    from ..pose_estimator.results import write_atomically, write_results
    from ..pose_estimator.stopwatch import Missing, in_own_process
    from .bench_table import markdown, table

    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDTH)
    lines: list[Record | Missing] = []
    for group in config.groups:
        with console.status(f"{group}: {GROUPS[group]}"):
            lines += in_own_process(run_group, group, config)
    if config.soak:
        from .bench_memory import measure_memory

        lines += measure_memory(config.soak, config.seed)
    records = [line for line in lines if isinstance(line, dict)]
    console.print(table(records))
    for line in lines:
        if isinstance(line, Missing):
            console.print(str(line), markup=False, highlight=False)
    if config.json is not None:
        write_results(config.json, records, command="bench", seed=config.seed)
    if config.markdown is not None:
        write_atomically(config.markdown, markdown(records).encode())
    if config.figure is not None:
        from .bench_cost import draw_costs

        draw_costs(config.figure, records)


def run_group(group: str, config: BenchConfig) -> list[Record | Missing]:
    """One of ``GROUPS``; imports only what it needs."""
    repeats, seed = config.repeats, config.seed
    if group == "rendering":
        from .bench_rendering import compare_renderers

        return [*compare_renderers(repeats, seed, config.pictures)]
    if group == "pyrender":
        from .bench_pyrender import compare_with_pyrender

        return compare_with_pyrender(repeats, seed)
    if group == "pixels":
        from .bench_pixels import compare_pixels

        return compare_pixels(repeats, seed)
    if group == "import":
        from .bench_import import compare_imports

        return [*compare_imports(repeats)]
    if group == "generate":
        from .bench_generator import measure_generator

        return [*measure_generator(config.scenes, seed)]
    if group in ("network", "solver", "metrics"):
        return run_estimator_group(group, repeats, seed)
    assert config.weights is not None
    if group == "vector":
        from .bench_vector import compare_vector

        return [*compare_vector(config.weights, repeats, seed)]
    if group == "estimator":
        from .bench_estimator import compare_estimates

        return [*compare_estimates(config.weights, repeats, seed)]
    from .bench_cost import measure_costs

    return [*measure_costs(config.weights, repeats, seed)]


def run_estimator_group(group: str, repeats: int, seed: int) -> list[Record | Missing]:
    """One of the groups that need nothing of the environment."""
    if group == "network":
        from ..pose_estimator.bench_network import compare_networks

        return [*compare_networks(repeats)]
    if group == "solver":
        from ..pose_estimator.bench_solver import compare_robustness, compare_speed

        return [*compare_speed(repeats, seed), compare_robustness(seed)]
    from .. import assets
    from ..pose_estimator.bench_metrics import compare_add_s

    models = {name: model for name, model in assets.load_objects(None).items() if model.symmetric}
    return [compare_add_s(models, repeats, seed)]
