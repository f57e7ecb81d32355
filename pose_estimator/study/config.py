"""Options of the command ``compare``."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from ...core.errors import InputError
from ...core.validation import require_within
from .. import METHODS


@dataclass(frozen=True)
class CompareConfig:
    """The comparative study: all methods on the same two tests, as tables, figures and a page.

    Writes results.json, report.html and figures/ to --out, and each pair of views as soon as it is
    measured: the same command resumes.
    """

    out: Path
    """Folder of the study; made where missing."""
    quick: bool = False
    """A few pairs of small tests, in three minutes: checks that everything works."""
    methods: tuple[str, ...] = METHODS
    """Which methods to run: single, early, late, mid, rgbd."""
    weights: str = "linemod"
    """Name of shipped weights, or a .safetensors file; it may lack the networks of some methods."""
    compare_weights: tuple[str, ...] = ()
    """Further weights for `mid`, NAME=FILE each, to compare with --weights on the same pairs: other
    presets or trainings. Those with the name `pose-noise` are measured with inexact relative poses
    too."""
    data: Path | None = None
    """Folder of the two tests, made where missing; none = data/ in --out."""
    pairs: int = 0
    """Maximum number of pairs for each object and gap; 0 = all."""
    compare_pairs: int = 0
    """Maximum number of pairs for each object and gap with --compare-weights; 0 = all."""
    noise_pairs: int = 20
    """Pairs for each object under every error of the relative pose; 0 = all."""
    images: int = 2
    """Pairs of each test to draw."""
    seed: int = 0
    """Random seed of the errors of the relative pose and of the pairs to draw."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU if there is one, else the CPU), `cpu`, `cuda`, `cuda:N` or
    `mps`."""
    threads: int = 0
    """CPU threads for estimates; 0 = all cores."""
    report_only: bool = False
    """Only draw the charts and the page again from results.json."""

    def __post_init__(self) -> None:
        unknown = [method for method in self.methods if method not in METHODS]
        if unknown or not self.methods:
            raise InputError(
                f"methods must be some of {', '.join(METHODS)}, got {', '.join(self.methods)}"
            )
        names = [text.partition("=")[0] for text in self.compare_weights]
        wrong = [t for t in self.compare_weights if not all(t.partition("="))]
        if wrong or len(set(names)) < len(names):
            raise InputError(
                f"compare_weights must be NAME=FILE with distinct names, got {self.compare_weights}"
            )
        require_within(
            self, 0, math.inf, "pairs", "compare_pairs", "noise_pairs", "images", "seed", "threads"
        )

    @property
    def test_data(self) -> Path:
        """Folder of the tests."""
        return self.data or self.out / "data"

    def reduced(self) -> CompareConfig:
        """Returns the options themselves, or with few pairs for a quick run."""
        return replace(self, noise_pairs=1, images=1) if self.quick else self

    @property
    def other_weights(self) -> dict[str, str]:
        """The files of ``compare_weights`` by name."""
        return dict(text.split("=", 1) for text in self.compare_weights)

    @property
    def cost_repeats(self) -> int:
        """Timed estimates of each method."""
        return 2 if self.quick else 20

    @property
    def per_gap(self) -> int:
        """Maximum number of pairs of each gap and test; 0 = all."""
        return 3 if self.quick else 0

    def command(self) -> str:
        """Returns the command line that gives the same results, without local paths."""
        words = ["compare", "--out", self.out.name]
        if self.quick:
            words.append("--quick")
        if set(self.methods) != set(METHODS):
            words += ["--methods", *self.methods]
        for name in ("weights", "pairs", "compare_pairs", "noise_pairs", "seed"):
            value = getattr(self, name)
            if value != getattr(type(self), name):
                text = Path(value).name if name == "weights" else str(value)
                words += [f"--{name.replace('_', '-')}", text]
        if self.compare_weights:
            others = [f"{name}={Path(file).name}" for name, file in self.other_weights.items()]
            words += ["--compare-weights", *others]
        return " ".join(words)
