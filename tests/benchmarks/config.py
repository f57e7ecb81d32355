"""What the benchmarks compare, and the options of ``python tests/benchmarks``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from two_view_pose.pose_estimator.fusion.estimator import KeypointEstimator


class Group(NamedTuple):
    """Comparisons that run in one process.

    Attributes:
        module: the file that has their function ``measure``.
        summary: one line.
        needs_weights: whether it runs a trained estimator.
    """

    module: str
    summary: str
    needs_weights: bool = False


GROUPS = {
    "rendering": Group("rendering", "RGB, depth and masks, against mujoco.Renderer"),
    "pyrender": Group("pyrender", "the same, and all annotations, against pyrender"),
    "pixels": Group(
        "pixels", "steps and episodes of pixels, against Gymnasium's renderer and dm_control"
    ),
    "vector": Group(
        "vector", "eight sub-environments, against as many single ones in sequence", True
    ),
    "estimator": Group("estimator", "Mid-Fusion and a step, against PVNet and ResNet-18", True),
    "busy": Group(
        "busy", "an estimate, a vector step and training with busy processes, against alone", True
    ),
    "network": Group("network", "the 3D network's operations, against a large matrix product"),
    "solver": Group("solver", "Soft RANSAC, against the RANSACs of OpenCV and Open3D"),
    "metrics": Group("metrics", "ADD-S, against the BOP toolkit's way"),
    "import": Group("import_time", "importing the package, against importing Gymnasium"),
    "generate": Group("generator", "images a second of the generator"),
    "cost": Group("cost", "cost against size, which --figure draws", True),
}
"""The groups, in the order in which they run."""


@dataclass(frozen=True)
class BenchConfig:
    """Times our code against the alternatives, side by side in one run."""

    repeats: int = 15
    """Timed repeats of each side; the median counts."""
    only: tuple[str, ...] = ()
    """Groups to run: rendering, pyrender, pixels, vector, estimator, busy, network, solver,
    metrics, import, generate, cost. None named: all of them."""
    weights: str | None = "linemod"
    """Weights of the estimator; None leaves out what needs them."""
    scenes: int = 26
    """Scenes of four images that the generator makes on two workers; 0 skips this group."""
    soak: int = 0
    """Only measure memory, over this number of steps of the environment."""
    seed: int = 0
    """Random seed of scenes, poses and actions."""
    json: Path | None = None
    """Results file, which holds each ratio as soon as it is measured. If it is that of an
    interrupted run with the same options, processor and code, the run resumes there."""
    markdown: Path | None = None
    """Write the table as Markdown."""
    figure: Path | None = None
    """Draw cost against size into this PNG."""
    images: Path | None = None
    """Also write both renderers' images, side by side, to this PNG."""

    def __post_init__(self) -> None:
        for group in self.only:
            if group not in GROUPS:
                raise ValueError(f"only must name some of {', '.join(GROUPS)}, got {group!r}")
        if self.repeats < 1:
            raise ValueError(f"repeats must be >= 1, got {self.repeats}")
        if self.figure is not None and "cost" not in self.groups:
            raise ValueError("--figure needs the group cost, which is not selected")

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups to run."""
        if self.soak:
            return ()
        skipped = set() if self.scenes else {"generate"}
        if self.weights is None:
            skipped |= {name for name, group in GROUPS.items() if group.needs_weights}
        if not (self.only or self.json or self.figure):
            skipped.add("cost")  # it is in no table
        return tuple(g for g in GROUPS if g in (self.only or GROUPS) and g not in skipped)

    def load_default(self) -> KeypointEstimator:
        """The default method with the weights, for groups that need them."""
        from two_view_pose.pose_estimator import load

        assert self.weights is not None
        return load(weights=self.weights, device="cpu")

    @property
    def fewer_repeats(self) -> int:
        """Timed repeats of what takes long."""
        return max(3, self.repeats // 3)
