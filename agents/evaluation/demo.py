"""The command ``demo``: runs one episode, prints its errors and writes an image."""

import math
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import gymnasium as gym
import numpy as np

from ...core.device import check_device
from ...core.errors import InputError
from ...core.images import check_image_suffix, write_image
from ...core.results import write_results
from ...core.validation import require_within
from ...envs.simulation.scene_kinds import SceneKindName


@dataclass(frozen=True)
class DemoConfig:
    """Run one episode: estimate a pose, choose a second view, and estimate the pose from both."""

    object: str | None = None
    """Name of the target object; by default a random one."""
    scene: SceneKindName = "occlusion"
    """Light clutter, heavy clutter, the target between tall objects, or a dense heap of objects."""
    policy: str = "greedy"
    """Policy of the second view: greedy (a shipped trained agent), random, fixed (30 degrees to the
    side), above, max-baseline (farthest in angle), uncertainty, oracle (ground truth), or a file of
    train-agent."""
    seed: int = 0
    """Random seed of the scene."""
    env: Literal["TwoViewPose-v0", "TwoViewPoseDiscrete-v0"] = "TwoViewPose-v0"
    """Any view on the view sphere, or one of a fixed set."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU if there is one, else the CPU), `cpu`, `cuda`, `cuda:N` or
    `mps`."""
    out: Path = Path("demo.png")
    """File for the image."""
    json: Path | None = None
    """File for machine-readable results."""

    def __post_init__(self) -> None:
        require_within(self, 0, math.inf, "seed")
        if self.policy == "stay":
            raise InputError("policy must take a second view, got 'stay'")


def demo(config: DemoConfig) -> None:
    """Runs one episode, prints the pose error before and after, and writes the image.

    Raises:
        InputError: if an option is wrong, there is no such device, or the weights are missing.
        GraphicsUnavailable: if OpenGL is unavailable.
    """
    check_device(config.device)
    check_image_suffix(config.out, "out")
    start = perf_counter()
    from ..policies.registry import make_policy

    env = gym.make(
        f"two_view_pose:{config.env}",
        scene=config.scene,
        device=config.device,
        render_mode="rgb_array",
    )
    try:
        policy = make_policy(config.policy, env, config.device)
        options = {} if config.object is None else {"object": config.object}
        observation, _ = env.reset(seed=config.seed, options=options)
        policy.reset(np.random.default_rng(config.seed))
        _, _, _, _, info = env.step(policy.act(observation))
        frame: Any = env.render()
    finally:
        env.close()
    write_image(config.out, frame)
    _print(config, info, perf_counter() - start)
    if config.json is not None:
        command = f"demo --scene {config.scene} --policy {config.policy} --seed {config.seed}"
        write_results(config.json, make_records(config, info), command=command, seed=config.seed)


def make_records(config: DemoConfig, info: dict[str, Any]) -> list[dict[str, Any]]:
    """Makes the records of the results file; ``views`` is the number of views of the estimate."""
    tags = {"object": info["object"], "scene": config.scene, "policy": config.policy}
    records = [{"metric": "travel", "value": info["travel"], "unit": "m", **tags}]
    for views, key in ((2, "add_second"), (1, "add_first")):
        ratio = info["ground_truth"][key] / info["diameter"]
        record = {"metric": "add_over_diameter", "value": ratio, "unit": "1", "views": views}
        records.insert(0, record | tags)
    return records


def _print(config: DemoConfig, info: dict[str, Any], seconds: float) -> None:
    """Prints the pose error before and after the second view."""
    from rich.console import Console
    from rich.table import Table

    truth, diameter = info["ground_truth"], info["diameter"]
    table = Table("pose from")
    for title in ("ADD(-S)", "of the diameter", "below a tenth"):
        table.add_column(title, justify="right")
    for name, key in (("the first view", "add_first"), ("both views", "add_second")):
        ratio = truth[key] / diameter
        success = "yes" if ratio < 0.1 else "no"
        table.add_row(name, f"{1e3 * truth[key]:.1f} mm", f"{100 * ratio:.1f} %", success)
    console = Console(highlight=False)
    console.print(
        f"object       {info['object']}, {1e3 * diameter:.0f} mm in diameter, "
        f"{100 * truth['visibility']:.0f} % of it visible in the first view\n"
        f"second view  {info['baseline_deg']:.0f} degrees from the first, chosen by "
        f"{config.policy}; it moved {info['travel']:.2f} m"
    )
    console.print(table)
    console.print(f"image        {config.out}   ({seconds:.1f} s in all)")
