"""The options of ``generate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from ...core.errors import InputError
from ..simulation.scene_kinds import SceneMixtureName
from ..simulation.trajectories.stereo import check_stereo

Sampling = Literal["sphere", "hand-held", "mixed", "stereo"]
Annotations = Literal["full", "basic"]
DomainRandomization = Literal["default", "strong"]


@dataclass(frozen=True)
class GenerateConfig:
    """Renders paired training or test data and writes it in BOP format.

    A run that was killed is finished by the same command. The folder can be read by anything that
    reads BOP, and by ``train-estimator --data`` and ``evaluate --data``; ``--verify`` checks it.
    """

    out: Path
    """Folder of the dataset; made where missing."""
    scenes: int = 100
    """How many scenes (arrangements of objects)."""
    views: int = 4
    """Images of each scene, the first of them the reference view; of hand-held scenes, the frames
    of the sequence."""
    objects: tuple[str, ...] = ()
    """Names of our objects, mesh files (NAME=FILE calls one so) or folders of them; empty: all
    thirteen. Each is the target equally often."""
    distractors: tuple[str, ...] = ()
    """Further objects that stand around, are annotated too, and are never the target."""
    scene: SceneMixtureName = "mixed"
    """`linemod` (light clutter), `clutter` (heavy), `occlusion` (the target between tall things) or
    `heap` (eight objects close together); `mixed` is the first two by turns, `all` these and
    heaps."""
    sampling: Sampling = "sphere"
    """Views spread over the sphere around the target, frames of a hand-held camera's path (1.5 to
    3 cm from one to the next), or both by turns; then the hand-held scenes are one reference view
    and a frame at each gap from it. Or pairs of a stereo rig that goes over the sphere, left and
    right by turns, so that views must be even."""
    gaps: tuple[int, ...] = (1, 5, 10)
    """Hand-held: frames between the two views of a pair."""
    references: int = 0
    """Hand-held: how many frames of a sequence are reference views, spread evenly; frames that no
    pair needs are not rendered. 0: every frame that has followers at all gaps."""
    stereo_baseline: float = 0.12
    """Stereo: meters from the left camera to the right one, along the left one's +x."""
    split: str = "train_pbr"
    """Name of the split's folder; one that begins with "test" also gets a list of targets."""
    seed: int = 0
    """Same seed, same bytes; test data needs another seed than training data."""
    workers: int = 2
    """Processes that render."""
    worker_memory: float = 2.0
    """Gigabytes; a worker that holds more after a scene is replaced by a fresh one. 0: never. With
    images of 640x480 a worker holds about half a gigabyte."""
    shard: tuple[int, int] = (0, 1)
    """K N: render only the scenes whose number leaves remainder K when divided by N, so that N
    machines share one folder. Afterwards the same command without --shard finishes the dataset."""
    width: int = 640
    """Width of the images in pixels; the camera is LineMOD's, scaled."""
    height: int = 480
    """Height of the images in pixels."""
    view_angles: tuple[float, float] = (10.0, 75.0)
    """Smallest and largest angle in degrees between the reference view and another, seen from the
    target."""
    pair_angles: tuple[float, float] = (10.0, 60.0)
    """Views around the target: angles in degrees of the pairs that two_view_pairs.json lists."""
    depth: bool = False
    """Also write depth maps (16-bit PNG)."""
    depth_noise: bool = False
    """Depth maps as a Kinect would see them, with noise, steps and holes; otherwise exact ones."""
    masks: bool = True
    """Also write masks of the objects' visible pixels and of their whole silhouettes."""
    annotations: Annotations = "full"
    """Full: all that BOP asks for. Basic: without masks of whole silhouettes, px_count_valid is
    px_count_all, and pairs do not say what is visible."""
    coco: bool = False
    """Also write scene_gt_coco.json, also to a dataset that is finished."""
    jpeg_quality: int = 92
    """Quality of the JPEG images, 1 to 100; 0 writes PNG."""
    randomize: bool = True
    """Random lights, textures, materials and sensor; otherwise one neutral look."""
    domain_randomization: DomainRandomization = "default"
    """Default: furniture in plain materials. Strong: posters and markers everywhere, stronger
    light, colors and noise, a rolled camera; for estimators that are used on photographs."""
    verify: bool = False
    """Render nothing: check every file that is there, and name those that are missing, changed or
    extra. Needs nothing but --out."""
    json: Path | None = None
    """File for machine-readable results."""

    def __post_init__(self) -> None:
        for name, minimum in _MINIMUMS.items():
            if not getattr(self, name) >= minimum:
                raise InputError(f"{name} must be at least {minimum}, got {getattr(self, name)}")
        for name, (low, high) in _RANGES.items():
            if not low <= getattr(self, name) <= high:
                raise InputError(f"{name} must be {low} to {high}, got {getattr(self, name)}")
        for name in ("view_angles", "pair_angles"):
            lowest, highest = getattr(self, name)
            if not 0 <= lowest <= highest <= 150:
                raise InputError(
                    f"{name} must rise within 0 to 150 degrees, got {(lowest, highest)}"
                )
        for name, kind in _CHOICES.items():
            if getattr(self, name) not in get_args(kind):
                raise InputError(
                    f"{name} must be one of {', '.join(get_args(kind))}, "
                    f"got {getattr(self, name)!r}"
                )
        if not 0 <= self.shard[0] < self.shard[1]:
            raise InputError(f"shard must be K and N with 0 <= K < N, got {self.shard}")
        if not self.gaps or list(self.gaps) != sorted({max(1, gap) for gap in self.gaps}):
            raise InputError(f"gaps must rise from at least 1, got {self.gaps}")
        if self.sampling == "hand-held" and self.views <= max(self.gaps):
            raise InputError(
                f"views must be more than the largest gap, {max(self.gaps)}, in hand-held "
                f"sequences, got {self.views}"
            )
        if self.sampling == "stereo":
            check_stereo(self.views, self.stereo_baseline)
        if self.coco and not (self.masks and self.annotations == "full"):
            raise InputError("coco needs masks of the whole silhouettes: masks, full annotations")
        if self.depth_noise and not self.depth:
            raise InputError("depth_noise needs depth: without it no depth maps are written")
        if not self.split or Path(self.split).name != self.split:
            raise InputError(f"split must be the name of a folder, got {self.split!r}")


_MINIMUMS = {"scenes": 1, "views": 1, "workers": 1, "seed": 0, "references": 0, "worker_memory": 0}
_RANGES = {"width": (16, 4096), "height": (16, 4096), "jpeg_quality": (0, 100)}
_CHOICES: dict[str, Any] = {
    "scene": SceneMixtureName,
    "sampling": Sampling,
    "annotations": Annotations,
    "domain_randomization": DomainRandomization,
}
