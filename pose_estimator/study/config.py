"""Options of the command ``compare``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from ...core.errors import InputError
from .. import METHODS

QUICK_PAIRS = 3
"""Pairs of each gap and test in a quick run."""


@dataclass(frozen=True)
class CompareConfig:
    """The comparative study: all methods on the same two tests, as tables, figures and a page.

    Writes results.json, report.html and figures/ to --out. Every pair of views is kept there once
    it is measured, so the same command resumes a run that was killed.
    """

    out: Path
    """Folder of the study; made where missing."""
    quick: bool = False
    """A few pairs of small tests, in three minutes: it shows that all works, not how well."""
    methods: tuple[str, ...] = METHODS
    """Which methods to run: single, early, late, mid, rgbd."""
    weights: str = "linemod"
    """Name of shipped weights, or a .safetensors file. Methods whose networks they
    lack are reported as not available."""
    noisy_weights: str | None = None
    """Weights that were trained with errors of the relative pose, to compare under such errors."""
    no_pose_loss_weights: str | None = None
    """Weights that were trained without the loss on the pose, to compare with those that were."""
    data: Path | None = None
    """Folder of the two tests, made where missing; none = data/ in --out."""
    pairs: int = 0
    """At most so many pairs for each object and gap; 0 = all."""
    noise_pairs: int = 20
    """Pairs for each object under every error of the relative pose; 0 = all."""
    pictures: int = 2
    """Pairs of each test to draw."""
    seed: int = 0
    """Random seed of the errors of the relative pose and of the pairs that are drawn. The tests
    have seeds of their own."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU where there is one, else the processor), `cpu`, `cuda`,
    `cuda:N` or `mps`."""
    threads: int = 0
    """Threads of the processor that estimates may use; 0: all cores."""
    report_only: bool = False
    """Only draw the charts and the page again from results.json."""

    def __post_init__(self) -> None:
        unknown = [method for method in self.methods if method not in METHODS]
        if unknown or not self.methods:
            raise InputError(
                f"methods must be some of {', '.join(METHODS)}, got {', '.join(self.methods)}"
            )
        for name in ("pairs", "noise_pairs", "pictures", "seed", "threads"):
            if getattr(self, name) < 0:
                raise InputError(f"{name} must be at least 0, got {getattr(self, name)}")

    @property
    def test_data(self) -> Path:
        """Where the tests are."""
        return self.data or self.out / "data"

    def reduced(self) -> CompareConfig:
        """As it is, or with few pairs where it shall be quick."""
        return replace(self, noise_pairs=1, pictures=1) if self.quick else self

    @property
    def cost_repeats(self) -> int:
        """Timed estimates of each method."""
        return 2 if self.quick else 20

    @property
    def per_gap(self) -> int:
        """At most so many pairs of each gap; 0 = all."""
        return QUICK_PAIRS if self.quick else 0

    def command(self) -> str:
        """The command line that asks for the same numbers."""
        words = ["compare", "--out", self.out.name]
        if self.quick:
            words.append("--quick")
        if set(self.methods) != set(METHODS):
            words += ["--methods", *self.methods]
        files = ("weights", "noisy_weights", "no_pose_loss_weights")
        for name in (*files, "pairs", "noise_pairs", "seed"):
            value = getattr(self, name)
            if value != getattr(type(self), name):
                # Without the folders of this machine.
                text = Path(value).name if name in files else str(value)
                words += [f"--{name.replace('_', '-')}", text]
        return " ".join(words)
