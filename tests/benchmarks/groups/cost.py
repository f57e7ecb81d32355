"""Cost against size: bodies in a scene, crops in a batch, voxels in a volume."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from two_view_pose import assets
from two_view_pose.envs.simulation.arrangement import Arrangement, Prop
from two_view_pose.envs.simulation.camera import view_sphere_pose
from two_view_pose.envs.simulation.placement import PlacedObject
from two_view_pose.envs.simulation.renderer import SceneRenderer
from two_view_pose.envs.simulation.scene import Scene
from two_view_pose.pose_estimator.networks.inference import Inference

from ..config import BenchConfig
from ..stopwatch import WARM_UP, Record, in_turn, seconds
from .network import volume_run
from .solver import draw_problems, soft_ransac_poses

BODIES = (2, 5, 10, 20, 30, 40, 60)
BATCHES = (1, 2, 4, 8, 16, 32)
CELLS = (16, 24, 32, 40, 48, 60)
_SPACING = 0.13
"""Between neighboring bodies on the table, meters."""

_PANELS = (
    ("An image of 640x480", "bodies", "bodies in view", BODIES, ("RGB", "RGB, depth and masks")),
    ("A crop in a batch", "batch", "size of the batch", BATCHES, ("2D network and votes",)),
    ("A pose in a batch", "batch", "size of the batch", BATCHES, ("Soft RANSAC",)),
    ("A volume", "cells", "voxels along a side", CELLS, ("3D network",)),
)
"""Of the figure: title, tag of the size, what it is, its ticks, and works with a curve each."""


def measure(config: BenchConfig) -> Iterator[Record]:
    """Records ``seconds``, with ``work`` and one of ``bodies``, ``batch``, ``cells``."""
    yield from render_costs(BODIES, config.repeats)
    yield from crop_costs(config, BATCHES)
    yield from solver_costs(BATCHES, config.repeats, config.seed)
    yield from volume_costs(CELLS, config.fewer_repeats)


def render_costs(bodies: tuple[int, ...], repeats: int) -> list[Record]:
    """Images of 640x480 of so many objects, from one camera; the others are out of view."""
    scene = crowded_scene(max(bodies))
    T_cam_world = view_sphere_pose(np.zeros(3), 1.4, 0.0, np.deg2rad(50.0))
    kinds: dict[str, dict[str, Any]] = {
        "RGB": {},
        "RGB, depth and masks": {"depth": True, "masks": True},
    }
    times: dict[tuple[str, int], list[float]] = {(k, n): [] for k in kinds for n in bodies}
    with closing(SceneRenderer(scene)) as renderer:
        for _ in range(repeats + WARM_UP):
            for count in bodies:
                show(scene, count)
                for kind, wanted in kinds.items():
                    draw = partial(renderer.render, T_cam_world, **wanted)
                    times[kind, count].append(seconds(draw))
    return [_record(kind, took[WARM_UP:], bodies=n) for (kind, n), took in times.items()]


def crowded_scene(count: int) -> Scene:
    """A scene with our thirteen objects again and again, ``count`` in all."""
    models = list(assets.load_objects(None).values())
    copies = [(f"{m.name}{n}", m) for n in range(-(-count // len(models))) for m in models]
    return Scene({name: replace(model, name=name) for name, model in copies[:count]})


def show(scene: Scene, count: int) -> None:
    """Puts the first ``count`` objects upright on the table, from the middle outwards."""
    side = int(np.ceil(np.sqrt(len(scene.objects))))
    steps = (np.arange(side) - (side - 1) / 2) * _SPACING
    places = sorted(product(steps, steps), key=lambda xy: float(np.hypot(*xy)))
    names = list(scene.objects)[:count]
    scene.show(
        Arrangement(
            {
                name: Prop(PlacedObject(scene.stable_poses[name][0], np.array(xy), 0.0))
                for name, xy in zip(names, places, strict=False)
            },
            {},
        )
    )


def crop_costs(config: BenchConfig, batches: tuple[int, ...]) -> list[Record]:
    """The 2D network and its votes, as the estimator asks them, for each crop of a batch."""
    networks = config.load_default().networks
    side = networks.features.config.crop
    rng = np.random.default_rng(config.seed)
    encode = Inference(networks).encode
    asked = [
        partial(encode, [(rng.integers(0, 256, (batch, side, side, 3), dtype=np.uint8), 0)])
        for batch in batches
    ]
    return _by_batch("2D network and votes", batches, in_turn(asked, config.repeats))


def solver_costs(batches: tuple[int, ...], repeats: int, seed: int) -> list[Record]:
    """Soft RANSAC for each pose of a batch."""
    rng = np.random.default_rng(seed)
    solved = [partial(soft_ransac_poses, draw_problems(rng, batch)) for batch in batches]
    return _by_batch("Soft RANSAC", batches, in_turn(solved, repeats))


def volume_costs(cells: tuple[int, ...], repeats: int) -> list[Record]:
    """The 3D network of ``paper`` on one volume of so many voxels along each side."""
    times = in_turn([volume_run("paper", side, 1) for side in cells], repeats)
    return [_record("3D network", t, cells=side) for side, t in zip(cells, times, strict=True)]


def draw_costs(path: Path, records: list[Record]) -> None:
    """Draws the records of :func:`measure` into one PNG: a panel for each size."""
    figure = Figure(figsize=(10, 6.4), layout="constrained")
    panels: Any = figure.subplots(2, 2).ravel()
    for panel, (title, size, label, ticks, works) in zip(panels, _PANELS, strict=True):
        curves = {w: [r for r in records if r["work"] == w and size in r] for w in works}
        for work, curve in curves.items():
            sizes = np.array([r[size] for r in curve], dtype=float)
            times = np.array([1000 * r["value"] for r in curve])
            panel.plot(sizes, times, "o-", label=work)
        if size == "cells":
            cubic = times[-1:] * (sizes / sizes[-1:]) ** 3
            panel.plot(sizes, cubic, "--", color="0.6", label="as voxels grow")
            panel.set(xscale="log", yscale="log")
            panel.yaxis.set_major_formatter("{x:g}")
        else:
            panel.set_ylim(0, None)
        if size == "batch":
            panel.set_xscale("log", base=2)
        panel.set_xticks(ticks, [str(tick) for tick in ticks])
        panel.minorticks_off()
        panel.set(xlabel=label, ylabel="milliseconds")
        panel.set_title(title, loc="left")
        panel.grid(color="0.9")
        panel.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)


def _by_batch(work: str, batches: tuple[int, ...], times: list[list[float]]) -> list[Record]:
    return [_record(work, t, n, batch=n) for n, t in zip(batches, times, strict=True)]


def _record(work: str, times: list[float], share: int = 1, **size: int) -> Record:
    value = float(np.median(times)) / share
    return {"metric": "seconds", "value": value, "unit": "s", "work": work, **size, "n": len(times)}
