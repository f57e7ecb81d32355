"""How cost grows with size: bodies in a scene, pictures in a batch, voxels in a volume."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..pose_estimator.bench_network import volume_run
from ..pose_estimator.bench_solver import draw_problems, soft_ransac_poses
from ..pose_estimator.stopwatch import WARM_UP, Record, in_turn, seconds
from .camera import view_sphere_pose

if TYPE_CHECKING:
    from .scene import Scene

BODIES = (2, 5, 10, 20, 30, 40, 60)
BATCHES = (1, 2, 4, 8, 16, 32)
CELLS = (16, 24, 32, 40, 48, 60)
_SPACING = 0.13
"""Between neighbouring bodies on the table, metres."""


def measure_costs(weights: str, repeats: int, seed: int) -> Iterator[Record]:
    """Records ``seconds`` of everything, with ``work`` and one of ``bodies``, ``batch``, ``cells``.

    Args:
        weights: of the 2D network.
        repeats: timed repeats; the median counts.
        seed: of the crops and the keypoints.
    """
    yield from render_costs(BODIES, repeats)
    yield from crop_costs(weights, BATCHES, repeats, seed)
    yield from solver_costs(BATCHES, repeats, seed)
    yield from volume_costs(CELLS, max(3, repeats // 3))


def render_costs(bodies: tuple[int, ...], repeats: int) -> list[Record]:
    """Pictures of 640x480 of so many objects, from one camera; as many more stand by unseen."""
    from .renderer import SceneRenderer

    scene = crowded_scene(max(bodies))
    T_cam_world = view_sphere_pose(np.zeros(3), 1.4, 0.0, np.deg2rad(50.0))
    kinds: dict[str, dict[str, Any]] = {
        "RGB": {},
        "RGB, depth and masks": {"depth": True, "masks": True},
    }
    times: dict[tuple[str, int], list[float]] = {(k, n): [] for k in kinds for n in bodies}
    with SceneRenderer(scene) as renderer:
        for _ in range(repeats + WARM_UP):
            for count in bodies:
                show(scene, count)
                for kind, wanted in kinds.items():
                    draw = partial(renderer.render, T_cam_world, **wanted)
                    times[kind, count].append(seconds(draw))
    return [_record(kind, took[WARM_UP:], bodies=n) for (kind, n), took in times.items()]


def crowded_scene(count: int) -> Scene:
    """A scene with our thirteen objects again and again, ``count`` in all."""
    from .. import assets
    from .scene import Scene

    models = list(assets.load_objects(None).values())
    copies = [(f"{m.name}{n}", m) for n in range(-(-count // len(models))) for m in models]
    return Scene({name: replace(model, name=name) for name, model in copies[:count]})


def show(scene: Scene, count: int) -> None:
    """Puts the first ``count`` objects upright on the table, from the middle outwards."""
    from .arrangement import Arrangement, Prop
    from .placement import PlacedObject

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


def crop_costs(weights: str, batches: tuple[int, ...], repeats: int, seed: int) -> list[Record]:
    """The 2D network and its votes, as the estimator asks them, for each crop of a batch."""
    from ..pose_estimator import load
    from ..pose_estimator.inference import Inference

    networks = load("mid", weights, device="cpu").networks
    side = networks.features.config.crop
    rng = np.random.default_rng(seed)
    encode = Inference(networks).encode
    asked = [
        partial(encode, [(rng.integers(0, 256, (batch, side, side, 3), dtype=np.uint8), 0)])
        for batch in batches
    ]
    return _by_batch("2D network and votes", batches, in_turn(asked, repeats))


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
    """Draws the records of :func:`measure_costs` into one PNG: a panel for each size."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6.4), layout="constrained")
    panels: Any = figure.subplots(2, 2).ravel()
    batched = [r for r in records if "batch" in r]
    poses = [r for r in batched if r["work"] == "Soft RANSAC"]
    crops = [r for r in batched if r not in poses]
    _panel(panels[0], [r for r in records if "bodies" in r], "bodies", "A picture of 640x480")
    _panel(panels[1], crops, "batch", "A crop in a batch")
    _panel(panels[2], poses, "batch", "A pose in a batch")
    _panel(panels[3], [r for r in records if "cells" in r], "cells", "A volume")
    panels[0].set(xlabel="bodies in view", ylim=(0, None))
    for panel in panels[1:3]:
        panel.set_xscale("log", base=2)
        panel.set(xlabel="size of the batch", ylim=(0, None))
    for panel, ticks in zip(panels, (BODIES, BATCHES, BATCHES, CELLS), strict=True):
        panel.set_xticks(ticks, [str(tick) for tick in ticks])
    panels[3].set(xlabel="voxels along a side", xscale="log", yscale="log")
    panels[3].set_xticks(CELLS, [str(side) for side in CELLS])
    panels[3].minorticks_off()
    sides = np.array([r["cells"] for r in records if "cells" in r], dtype=float)
    if len(sides):
        last = next(r["value"] for r in records if r.get("cells") == sides[-1])
        cubic = 1000 * last * (sides / sides[-1]) ** 3
        panels[3].plot(sides, cubic, "--", color="0.6", label="as voxels grow")
    panels[3].yaxis.set_major_formatter("{x:g}")
    for panel in panels:
        panel.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)


def _panel(panel: Any, records: list[Record], size: str, title: str) -> None:
    """One curve for each kind of work."""
    for work in dict.fromkeys(r["work"] for r in records):
        curve = [(r[size], 1000 * r["value"]) for r in records if r["work"] == work]
        panel.plot(*np.transpose(curve), "o-", label=work)
    panel.set_title(title, loc="left")
    panel.set_ylabel("milliseconds")
    panel.grid(color="0.9")


def _by_batch(work: str, batches: tuple[int, ...], times: list[list[float]]) -> list[Record]:
    return [_record(work, t, n, batch=n) for n, t in zip(batches, times, strict=True)]


def _record(work: str, times: list[float], share: int = 1, **size: int) -> Record:
    value = float(np.median(times)) / share
    return {"metric": "seconds", "value": value, "unit": "s", "work": work, **size, "n": len(times)}
