"""The options of ``generate``."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from ...core.errors import InputError
from ...core.units import LengthUnit
from ...core.validation import require_choice, require_range, require_within
from ..simulation.scene_kinds import SCENE_KINDS, SCENE_MIXTURES, SceneMixtureName
from ..simulation.trajectories.stereo import check_stereo

Sampling = Literal["sphere", "hand-held", "mixed", "stereo"]
Annotations = Literal["full", "basic"]
DomainRandomization = Literal["default", "strong"]


@dataclass(frozen=True)
class GenerateConfig:
    """Renders paired training or test data and writes it in BOP format.

    The same command resumes an interrupted run. The folder is a BOP dataset, also for
    ``train-estimator --data`` and ``evaluate --data``; ``--verify`` checks its checksums.
    """

    out: Path
    """Folder of the dataset; created if missing."""
    scenes: int = 100
    """Number of scenes (arrangements of objects)."""
    views: int = 4
    """Images of each scene, the first of them the reference view; of hand-held scenes, the frames
    of the sequence."""
    objects: tuple[str, ...] = ()
    """Names of shipped objects, mesh files (NAME=FILE names one) or folders of them; empty: all
    thirteen. Each is the target equally often."""
    distractors: tuple[str, ...] = ()
    """Further objects, which are annotated too but never the target."""
    unit: LengthUnit = "auto"
    """Unit of the mesh files: `mm`, `cm`, `m` or `inch`; `auto` reads a diameter of 0.02 to 1 as
    meters and of 20 to 1000 as millimeters, and prints that."""
    scene: SceneMixtureName = "mixed"
    """`linemod` (light clutter), `clutter` (heavy), `occlusion` (the target between tall props) or
    `heap` (dense clutter of eight objects, all upright); `mixed` alternates between the first two,
    `all` between these and `heap`."""
    sampling: Sampling = "sphere"
    """`sphere`: views spread over the sphere around the target. `hand-held`: frames of a camera
    path, 1.5 to 3 cm apart. `mixed`: alternately both; hand-held scenes then have one reference
    view and a frame at each gap from it. `stereo`: pairs of a stereo rig on the sphere, left and
    right alternating, so that views must be even."""
    gaps: tuple[int, ...] = (1, 5, 10)
    """Hand-held: frames between the two views of a pair."""
    references: int = 0
    """Hand-held: number of reference views of a sequence, spread evenly; frames that no pair needs
    are not rendered. 0: every frame that has a second view at all gaps."""
    stereo_baseline: float = 0.12
    """Stereo: meters from the left camera to the right one, along the left one's +x."""
    split: str = "train_pbr"
    """Name of the split's folder; if it begins with "test", a list of targets is written."""
    seed: int = 0
    """Same seed, same bytes; use different seeds for training and test data."""
    workers: int = 2
    """Number of rendering processes."""
    worker_memory: float = 2.0
    """Gigabytes; a worker that uses more after a scene is replaced. 0: never. With 640x480 images a
    worker uses about half a gigabyte."""
    shard: tuple[int, int] = (0, 1)
    """K N: render only the scenes whose number leaves remainder K when divided by N, so that N
    machines share one folder. Afterwards the same command without --shard finishes the dataset."""
    width: int = 640
    """Width of the images in pixels; the camera is LineMOD's, scaled."""
    height: int = 480
    """Height of the images in pixels."""
    view_angles: tuple[float, float] = (10.0, 75.0)
    """(min, max) of the angle at the target between the reference view and another, degrees."""
    pair_angles: tuple[float, float] = (10.0, 60.0)
    """(min, max) of that angle in the pairs that two_view_pairs.json lists, degrees."""
    depth: bool = False
    """Also write depth maps (16-bit PNG)."""
    depth_noise: bool = False
    """Depth maps of a simulated Kinect, with noise, steps and holes; otherwise exact ones."""
    masks: bool = True
    """Also write masks of the objects' visible pixels and of their full silhouettes."""
    annotations: Annotations = "full"
    """`full`: all of BOP's. `basic`: without masks of full silhouettes, px_count_valid is
    px_count_all, and pairs have no visible fractions."""
    coco: bool = False
    """Also write scene_gt_coco.json, also to a finished dataset."""
    jpeg_quality: int = 92
    """Quality of the JPEG images, 1 to 100; 0 writes PNG."""
    randomize: bool = True
    """Randomize lights, textures, materials and sensor."""
    domain_randomization: DomainRandomization = "default"
    """`default`: furniture in plain materials. `strong`: also posters and markers, wider ranges of
    light, color, noise and camera roll; for sim-to-real transfer."""
    verify: bool = False
    """Only verify checksums: list files that are missing, changed or extra. Needs only --out."""
    json: Path | None = None
    """File for machine-readable results."""

    def __post_init__(self) -> None:
        require_within(self, 1, math.inf, "scenes", "views", "workers")
        require_within(self, 0, math.inf, "seed", "references", "worker_memory")
        require_within(self, 16, 4096, "width", "height")
        require_within(self, 0, 100, "jpeg_quality")
        require_range(self, 0, 150, "view_angles", "pair_angles")
        require_choice(self, (*SCENE_KINDS, *SCENE_MIXTURES), "scene")
        require_choice(self, get_args(Sampling), "sampling")
        require_choice(self, get_args(Annotations), "annotations")
        require_choice(self, get_args(DomainRandomization), "domain_randomization")
        if not 0 <= self.shard[0] < self.shard[1]:
            raise InputError(f"shard must be K and N with 0 <= K < N, got {self.shard}")
        if not self.gaps or list(self.gaps) != sorted({max(1, gap) for gap in self.gaps}):
            raise InputError(f"gaps must be >= 1 and increasing, got {self.gaps}")
        if self.sampling == "hand-held" and self.views <= max(self.gaps):
            raise InputError(
                f"views must be > the largest gap {max(self.gaps)} of hand-held sequences, "
                f"got {self.views}"
            )
        if self.sampling == "stereo":
            check_stereo(self.views, self.stereo_baseline)
        if self.coco and not (self.masks and self.annotations == "full"):
            raise InputError("coco needs masks of full silhouettes: masks, full annotations")
        if self.depth_noise and not self.depth:
            raise InputError("depth_noise needs depth")
        if not self.split or Path(self.split).name != self.split:
            raise InputError(f"split must be the name of a folder, got {self.split!r}")
