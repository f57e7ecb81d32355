"""The verb ``bench``: how quick things are (and how robust), as ratios to what others would use.

Machines differ and drift, so both sides of a ratio run in turn in one process, and medians count.
"""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .scene import Scene


@dataclass(frozen=True)
class BenchConfig:
    """Times our work against what people would use instead, in one run."""

    repeats: int = 15
    """Timed repeats of each side; the median counts."""
    weights: str | None = "linemod"
    """Weights for the environment's step; None leaves that line out."""
    scenes: int = 26
    """Scenes of four pictures that the generator makes on two workers; 0 leaves that out."""
    seed: int = 0
    """Of the scene."""
    json: Path | None = None
    """Write the ratios as a results file."""
    pictures: Path | None = None
    """Also write both renderers' pictures, side by side, to this PNG."""


def bench(config: BenchConfig) -> None:
    """Runs all comparisons and prints them."""
    # MuJoCo's own renderer decides on its back-end when it is imported, and prefers a window.
    os.environ.setdefault("MUJOCO_GL", "egl")
    from rich.console import Console
    from rich.table import Table

    from ..pose_estimator import bench_solver
    from ..pose_estimator.results import write_results
    from .bench_generator import measure_generator
    from .bench_pyrender import INSTALL_HINT, PyrenderUnavailable, compare_with_pyrender

    records = [compare_renderers(config)]
    missing = None
    try:
        records.append(compare_with_pyrender(config.repeats, config.seed))
    except PyrenderUnavailable as error:
        missing = f"not compared with pyrender ({error}). To install it: {INSTALL_HINT}"
    records.append(bench_solver.compare_speed(config.repeats, config.seed))
    records.append(bench_solver.compare_robustness(config.seed))
    if config.weights is not None:
        records.append(compare_step(config))
    if config.scenes:
        records += measure_generator(config.scenes, config.seed)
    table = Table(title="side by side in one run, medians")
    for column in ("work", "against", "ours", "theirs", "ratio", "goal"):
        table.add_column(column)
    for record in records:
        table.add_row(*cells(record))
    Console().print(table)
    if missing is not None:
        Console().print(missing, markup=False, highlight=False)
    if config.json is not None:
        write_results(config.json, records, command="bench", seed=config.seed)


def cells(record: dict[str, Any]) -> tuple[str, ...]:
    """A record as a row of the table."""
    if record["metric"] != "ratio":
        value, goal = f"{record['value']:.1f}/s", f">= {record['goal']:g}/s"
        return record["work"], "", value, "", "", goal
    ours, theirs = amount(record), amount(record, "_against")
    ratio, goal = f"{record['value']:.2f}x", f">= {record['goal']:g}x"
    return record["work"], record["against"], ours, theirs, ratio, goal


def amount(record: dict[str, Any], side: str = "") -> str:
    """What one side of a comparison came to, for people."""
    if f"share{side}" in record:
        return f"{100 * record[f'share{side}']:.1f} %"
    return f"{1000 * record[f'seconds{side}']:.3g} ms"


def compare_renderers(config: BenchConfig) -> dict[str, Any]:
    """An RGB frame of ours against a default ``mujoco.Renderer``'s: same scene, size and camera."""
    from .. import assets
    from .renderer import SceneRenderer
    from .scene import Scene

    scene = Scene(assets.load_objects(None))
    state = scene.reset(np.random.default_rng(config.seed), scene.object_names[0])
    ours = SceneRenderer(scene)
    theirs = default_renderer(scene, state.T_cam_world)
    pictures = ours.render(state.T_cam_world).rgb, theirs()
    if config.pictures is not None:
        from PIL import Image

        Image.fromarray(np.hstack(pictures)).save(config.pictures)
    difference = np.abs(pictures[0].astype(int) - pictures[1]).mean()
    record = ratio(
        "RGB frame, 640x480",
        "mujoco.Renderer defaults",
        lambda: ours.render(state.T_cam_world),
        theirs,
        config.repeats,
        goal=3.0,
    )
    ours.close()
    scene.close()
    return {**record, "mean_difference_of_levels": float(difference)}


def default_renderer(scene: Scene, T_cam_world: np.ndarray) -> Callable[[], np.ndarray]:
    """A ``mujoco.Renderer`` of the scene as it is, with MuJoCo's default quality."""
    import mujoco

    from ..pose_estimator.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K
    from .graphics import aim

    height, width = LINEMOD_IMAGE_SIZE
    model = copy.copy(scene.world.model)
    quality = mujoco.MjSpec().compile().vis.quality
    model.vis.quality.offsamples = quality.offsamples
    model.vis.quality.shadowsize = quality.shadowsize
    model.vis.global_.offheight, model.vis.global_.offwidth = height, width
    renderer = mujoco.Renderer(model, height, width)

    def draw() -> np.ndarray:
        renderer.update_scene(scene.data)
        aim(renderer.scene, T_cam_world, LINEMOD_K, height, width)
        return renderer.render()

    return draw


def compare_step(config: BenchConfig) -> dict[str, Any]:
    """A whole ``env.step`` against one forward pass of a ResNet-18 on a 640x480 picture."""
    import gymnasium as gym
    import torch

    from ..pose_estimator import load
    from .reference_network import resnet18

    estimator = load("mid", config.weights or "linemod")
    env = gym.make("TwoViewPose-v0", estimator=estimator)
    network = resnet18().eval()
    picture = torch.zeros(1, 3, 480, 640)
    rng = np.random.default_rng(config.seed)

    def forward() -> None:
        with torch.inference_mode():
            network(picture)

    ours, theirs = [], []
    for repeat in range(config.repeats + 2):
        env.reset(seed=config.seed + repeat)
        action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        ours.append(seconds(partial(env.step, action)))
        theirs.append(seconds(forward))
    env.close()
    return make_record(
        "env.step: render, detect, estimate, reward",
        "ResNet-18 forward, 640x480",
        ours[2:],
        theirs[2:],
        goal=1.0,
    )


def seconds(work: Callable[[], Any]) -> float:
    """Wall time of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def ratio(
    work: str,
    against: str,
    ours: Callable[[], Any],
    theirs: Callable[[], Any],
    repeats: int,
    goal: float,
) -> dict[str, Any]:
    """Times two calls in turn, after two of each that do not count."""
    pairs = [(seconds(ours), seconds(theirs)) for _ in range(repeats + 2)][2:]
    return make_record(work, against, [a for a, _ in pairs], [b for _, b in pairs], goal)


def make_record(
    work: str, against: str, ours: list[float], theirs: list[float], goal: float
) -> dict[str, Any]:
    """The record of a comparison: how many times as fast ours is."""
    ours_median, theirs_median = float(np.median(ours)), float(np.median(theirs))
    return {
        "metric": "ratio",
        "value": theirs_median / ours_median,
        "unit": "",
        "work": work,
        "against": against,
        "goal": goal,
        "seconds": ours_median,
        "seconds_against": theirs_median,
        "n": len(ours),
    }
