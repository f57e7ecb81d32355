"""Options of the command ``evaluate``."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...core.errors import InputError
from ...core.units import LengthUnit
from ...core.validation import require_within
from ..methods import DEFAULT_METHOD


@dataclass(frozen=True)
class EvaluateConfig:
    """Measures an estimator: ADD(-S) below a tenth of the diameter, per object and in the mean.

    Either on new synthetic scenes (--scene, rendered first), or on a BOP dataset (--data). The
    estimator gets full frames, the camera matrix, the relative camera pose and the object's name;
    `rgbd` also gets the depth sensor's maps. On a dataset errors are measured on its own models,
    and where it lists targets (test_targets_bop19.json) pairs count for these.

    --score measures the poses of a BOP result file instead, for each target in the dataset's list
    and with the dataset's own models; a missing estimate is wrong. Estimator options are ignored.
    """

    method: str = DEFAULT_METHOD
    """The paper's `early`, `late` and `mid` (Mid-Fusion); `single`; our `pnp` (one pose for the
    votes of both views), `mid-pnp` (`mid`, refined by the votes) and `rgbd`."""
    refine: Literal["none", "votes"] | None = None
    """Whether the pose is refined by the votes of both views; none = as the method does."""
    weights: str = "linemod"
    """Name of shipped weights, or a .safetensors file."""
    preset: Literal["fast", "features", "paper"] | None = None
    """Preset of the volumes that the weights must have been trained for."""
    solver: Literal["soft", "soft-mean", "kabsch", "hard"] | None = None
    """From 3D keypoints to the pose: `soft` (Soft RANSAC), `soft-mean` (with the paper's plain
    average), `kabsch` or `hard` (RANSAC); none = that of the preset."""
    roi: Literal["detector", "truth", "noisy"] = "detector"
    """Initial region of interest. `truth` replaces the detector by the ground-truth ROI, `noisy` by
    that of the true center plus Gaussian noise for each image: 4 cm in depth and 1.2 cm sideways
    (standard deviations)."""
    scene: str = "linemod"
    """Kind of synthetic scenes: `linemod`, `clutter`, `occlusion` or `heap`, as with `generate`."""
    scenes: int = 520
    """Number of scenes; each object is the target equally often."""
    objects: tuple[str, ...] = ()
    """Objects of the scenes, by name or path of a mesh; none = all that the weights know. With
    --data: meshes on whose surface errors are measured where the dataset has no models."""
    unit: LengthUnit = "auto"
    """Unit of the mesh files: `mm`, `cm`, `m` or `inch`; `auto` reads a diameter of 0.02 to 1 as
    meters and of 20 to 1000 as millimeters, and prints that."""
    seed: int = 1000
    """Random seed of the scenes. Training data has other seeds."""
    data: Path | None = None
    """A BOP dataset instead of synthetic scenes: a folder, or a name below $BOP_PATH."""
    split: str = "test"
    """Split: the folder of its scenes."""
    pairs: Path | None = None
    """File with pairs of views; none = two_view_pairs.json of the dataset, or where it has none,
    pairs found from its poses: 10 to 60 degrees apart, four for each reference view."""
    gaps: tuple[int, ...] = ()
    """With --data: pair each image with those so many numbers after it, as the paper pairs the
    frames of a sequence, whatever the baseline; none = --pairs."""
    baselines: tuple[float, float] = (0.0, 180.0)
    """Smallest and largest angle in degrees between the two views, at the object."""
    both_directions: bool = False
    """Use each pair a second time with its views swapped."""
    csv: Path | None = None
    """Write the poses in the reference views as a BOP result file (METHOD_DATASET-SPLIT.csv). If a
    reference view is in several pairs, the one of the smallest keypoint variance."""
    score: Path | None = None
    """Run no estimator: score this BOP result file on --data."""
    cache_dir: Path | None = None
    """Keep the rendered scenes in this folder; reuse them if they are there already."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU if there is one, else the CPU), `cpu`, `cuda`, `cuda:N` or
    `mps`."""
    threads: int = 0
    """CPU threads that estimates may use; 0: all cores."""
    json: Path | None = None
    """Write the results as a results file."""

    def __post_init__(self) -> None:
        low, high = self.baselines
        if not 0 <= low <= high <= 180:
            raise InputError(f"baselines must rise within 0 to 180, got {self.baselines}")
        require_within(self, 0, math.inf, "threads")
        if any(gap < 1 for gap in self.gaps) or (self.gaps and self.data is None):
            raise InputError(f"gaps must be 1 or more and need --data, got {self.gaps}")
        if self.gaps and self.pairs is not None:
            raise InputError("gaps and pairs exclude each other: a file of pairs has its own")
