"""Options of the command ``evaluate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...core.errors import InputError


@dataclass(frozen=True)
class EvaluateConfig:
    """Measures an estimator: ADD(-S) below a tenth of the diameter, per object and in the mean.

    Either on fresh scenes of ours (--scene, rendered first), or on a BOP dataset (--data). The
    estimator gets full frames, the camera matrix, the relative camera pose and the object's name;
    `rgbd` also gets the depth sensor's maps. On a dataset errors are measured on its own models,
    and where it lists targets (test_targets_bop19.json) pairs count for these.

    --score measures poses of others instead: of each target in the dataset's list of targets, with
    the dataset's own models; what is missing is wrong. Options of an estimator are ignored.
    """

    method: str = "mid"
    """`single`, `early`, `late`, `mid` or `rgbd`."""
    weights: str = "linemod"
    """Name of shipped weights, or a .safetensors file."""
    preset: Literal["fast", "paper"] | None = None
    """Preset of the volumes that the weights must have been trained for: `fast` or `paper`."""
    solver: Literal["soft", "kabsch", "hard"] = "soft"
    """From 3D keypoints to the pose: `soft` (Soft RANSAC), `kabsch` or `hard` (RANSAC)."""
    roi: Literal["detector", "truth", "noisy"] = "detector"
    """Where the estimator looks first. The others are for analyses that leave the detector out:
    `truth` gives it the ground-truth ROI, `noisy` that of the true center plus noise of 4 cm in
    depth and 1.2 cm sideways (standard deviations, drawn for each image)."""
    scene: str = "linemod"
    """Kind of our scenes: `linemod`, `clutter`, `occlusion` or `heap`, as with `generate`."""
    scenes: int = 520
    """How many scenes; each of the objects is the target equally often."""
    objects: tuple[str, ...] = ()
    """Objects of our scenes, by name or path of a mesh; none = all that the weights know."""
    seed: int = 1000
    """Of the scenes. Training data has other seeds."""
    data: Path | None = None
    """A BOP dataset instead of our scenes: a folder, or a name below $BOP_PATH."""
    split: str = "test"
    """Folder of its scenes."""
    pairs: Path | None = None
    """File with pairs of views; none = two_view_pairs.json of the dataset, or where it has none,
    pairs found from its poses: 10 to 60 degrees apart, four for each reference view."""
    baselines: tuple[float, float] = (0.0, 180.0)
    """Only what the two views of a pair see from so many degrees apart, at the object."""
    both_directions: bool = False
    """Take each pair a second time with its views exchanged."""
    csv: Path | None = None
    """Write the poses in the reference views as a BOP result file, METHOD_DATASET-SPLIT.csv by
    custom. Where a reference view is in several pairs, the one of the smallest keypoint
    variance."""
    score: Path | None = None
    """Run no estimator: score this BOP result file, anyone's, on --data."""
    cache_dir: Path | None = None
    """Keep the rendered scenes in this folder; if they are there already, use them."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU where there is one, else the processor), `cpu`, `cuda`,
    `cuda:N` or `mps`."""
    threads: int = 0
    """Threads of the processor that estimates may use; 0: all cores."""
    json: Path | None = None
    """Write the results as a results file."""

    def __post_init__(self) -> None:
        low, high = self.baselines
        if not 0 <= low <= high <= 180:
            raise InputError(f"baselines must rise within 0 to 180, got {self.baselines}")
        if self.threads < 0:
            raise InputError(f"threads must be at least 0, got {self.threads}")
