"""Renders scenes for training and testing estimators, and writes them in BOP format.

One BOP scene is one arrangement of objects, seen by several cameras. Either the first is the
reference view and the others stand 10 to 75 degrees from it around the target, or they are frames
of a hand-held camera's sequence, or those of a stereo rig. What a scene holds depends only on the
seed and its number, so neither the number of workers nor a restart changes a byte.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

from tqdm import tqdm

from .scene_kinds import SceneMixtureName
from .stereo import check_stereo

if TYPE_CHECKING:
    from ..assets.object_model import ObjectModel
    from .scene_writer import SceneMaker

Sampling = Literal["sphere", "hand-held", "mixed", "stereo"]
Layout = Literal["full", "basic"]
Look = Literal["tidy", "busy"]


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
    """Pictures of each scene, the first of them the reference view; of hand-held scenes, the frames
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
    """Stereo: metres from the left camera to the right one, along the left one's +x."""
    split: str = "train_pbr"
    """Name of the split's folder; one that begins with "test" also gets a list of targets."""
    seed: int = 0
    """Same seed, same bytes; test data needs another seed than training data."""
    workers: int = 2
    """Processes that render."""
    worker_memory: float = 2.0
    """Gigabytes; a worker that holds more after a scene is replaced by a fresh one. 0: never. With
    pictures of 640x480 a worker holds about half a gigabyte."""
    ray: str | None = None
    """Render on a Ray cluster: its address, such as "head:6379", or "local" for one of this
    machine with as many workers as --workers says. Needs `pip install two-view-pose[ray]`, and
    the folder under one path on all machines."""
    width: int = 640
    """Width of the pictures in pixels; the camera is LineMOD's, scaled."""
    height: int = 480
    """Height of the pictures in pixels."""
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
    layout: Layout = "full"
    """Full: all that BOP asks for. Basic: without masks of whole silhouettes, px_count_valid is
    px_count_all, and pairs do not say what is visible. A folder that an older version began goes
    on as basic."""
    coco: bool = False
    """Also write scene_gt_coco.json, also to a dataset that is finished."""
    jpeg_quality: int = 92
    """Quality of the JPEG pictures, 1 to 100; 0 writes PNG."""
    randomize: bool = True
    """Random lights, textures, materials and sensor; otherwise one neutral look."""
    look: Look = "tidy"
    """Tidy: furniture in plain materials. Busy: posters and markers everywhere, stronger light,
    colours and noise, a camera held askew; for estimators that shall work on photographs."""
    verify: bool = False
    """Render nothing: check every file that is there, and name those that are missing, changed or
    extra. Needs nothing but --out."""
    json: Path | None = None
    """File for machine-readable results."""

    def __post_init__(self) -> None:
        at_least = {"scenes": 1, "views": 1, "workers": 1, "seed": 0, "references": 0}
        for name, least in at_least.items():
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, got {getattr(self, name)}")
        for name in ("width", "height"):
            if not 16 <= getattr(self, name) <= 4096:
                raise ValueError(f"{name} must be 16 to 4096 pixels, got {getattr(self, name)}")
        for name in ("view_angles", "pair_angles"):
            low, high = getattr(self, name)
            if not 0 <= low <= high <= 150:
                raise ValueError(f"{name} must rise within 0 to 150 degrees, got {(low, high)}")
        choices = {"scene": SceneMixtureName, "sampling": Sampling, "layout": Layout, "look": Look}
        for name, allowed in ((name, get_args(kind)) for name, kind in choices.items()):
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"{name} must be one of {', '.join(allowed)}, got {getattr(self, name)!r}"
                )
        if not self.gaps or list(self.gaps) != sorted({max(1, gap) for gap in self.gaps}):
            raise ValueError(f"gaps must rise from at least 1, got {self.gaps}")
        if self.sampling == "hand-held" and self.views <= max(self.gaps):
            raise ValueError(
                f"views must be more than the largest gap, {max(self.gaps)}, in hand-held "
                f"sequences, got {self.views}"
            )
        if self.sampling == "stereo":
            check_stereo(self.views, self.stereo_baseline)
        if not self.worker_memory >= 0:
            raise ValueError(f"worker_memory must be at least 0 GB, got {self.worker_memory}")
        if self.coco and not (self.masks and self.layout == "full"):
            raise ValueError(
                "coco needs masks of the whole silhouettes: masks, and the full layout, which a "
                "folder that an older version began does not have"
            )
        if self.depth_noise and not self.depth:
            raise ValueError("depth_noise needs depth: without it no depth maps are written")
        if not 0 <= self.jpeg_quality <= 100:
            raise ValueError(f"jpeg_quality must be 0 to 100, got {self.jpeg_quality}")
        if not self.split or Path(self.split).name != self.split:
            raise ValueError(f"split must be the name of a folder, got {self.split!r}")

    def maker(self) -> SceneMaker:
        """What makes the scenes in a worker."""
        from .scene_writer import SceneMaker

        return SceneMaker(self)


def generate(config: GenerateConfig) -> int:
    """Writes models and camera, renders the scenes that are missing, then lists their pairs.

    Returns:
        The exit code: 1 if ``config.verify`` is set and a file is not as it was written, else 0.

    Raises:
        ValueError: if the folder holds a dataset that was made with other settings, or an object
            is unknown.
        GraphicsUnavailable: if there is no OpenGL to draw with.
        ChildProcessError: if workers die again and again.
    """
    from ..pose_estimator.bop_writer import scene_folder
    from .checksums import SUMS_FILE, verify
    from .dataset_folder import claim_folder
    from .scene_plan import dataset_objects
    from .scene_writer import is_finished

    if config.verify:
        return min(1, verify(config.out))
    objects = dataset_objects(config)
    config = claim_folder(config, tuple(objects))
    (config.out / SUMS_FILE).unlink(missing_ok=True)  # it says that the run is finished
    _write_models(config, objects)
    ids = range(config.scenes)
    missing = [i for i in ids if not scene_folder(config.out, config.split, i).exists()]
    unfinished = [i for i in ids if not is_finished(config, i)]
    start = time.perf_counter()
    with tqdm(total=len(ids), initial=len(ids) - len(unfinished), unit="scene") as bar:
        for _ in _make_scenes(config, unfinished):
            bar.update()
    _write_lists(config)
    _report(config, tuple(objects), missing, time.perf_counter() - start)
    return 0


def _make_scenes(config: GenerateConfig, scene_ids: Sequence[int]) -> Iterator[int]:
    """Makes the scenes and yields the number of each that is ready."""
    from . import ray_engine, worker_pool
    from .scene_writer import SceneMaker

    if config.ray is not None and scene_ids:
        yield from ray_engine.make_scenes(config, scene_ids)
    elif config.workers > 1 and len(scene_ids) > 1:
        yield from worker_pool.make_scenes(config, scene_ids)
    else:
        with SceneMaker(config) as maker:
            for scene_id in scene_ids:
                maker.make(scene_id)
                yield scene_id


def _write_models(config: GenerateConfig, objects: Mapping[str, ObjectModel]) -> None:
    """Writes the models and the camera."""
    from ..pose_estimator.bop_models import write_evaluation_models, write_models
    from ..pose_estimator.bop_writer import write_camera
    from .scene_writer import scaled_intrinsics

    size = (config.height, config.width)
    write_models(config.out, objects.values())
    write_evaluation_models(config.out, objects.values())
    write_camera(config.out, scaled_intrinsics(*size), size)


def _write_lists(config: GenerateConfig) -> None:
    """Writes what is read back from the finished scenes: pairs, targets, checksums."""
    from ..pose_estimator.bop import read_dataset
    from ..pose_estimator.bop_pairs import PAIRS_FILE
    from ..pose_estimator.bop_targets import TARGETS_FILE, is_test, write_targets
    from ..pose_estimator.bop_writer import write_pairs
    from .checksums import write_dataset_sums
    from .dataset_folder import remove_leftovers
    from .pair_list import two_view_pairs

    out = config.out
    write_pairs(out / PAIRS_FILE, two_view_pairs(config))
    if is_test(config.split):
        write_targets(read_dataset(out, config.split), range(config.scenes))
    remove_leftovers(out, out / "models", out / "models_eval")
    beside = ["manifest.json", "camera.json", PAIRS_FILE, "models", "models_eval"]
    write_dataset_sums(out, config.split, [*beside, TARGETS_FILE])


def _report(
    config: GenerateConfig, names: Sequence[str], made: Sequence[int], seconds: float
) -> None:
    """Says how much there is, and how quick it was made."""
    from ..pose_estimator.results import write_results
    from .scene_plan import plan_scene

    pictures = [len(plan_scene(config, i, names).frames) for i in range(config.scenes)]
    new = sum(pictures[i] for i in made)
    print(
        f"{config.scenes} scenes, {sum(pictures)} pictures in {config.out / config.split}; "
        f"{new} pictures made now, {new / seconds:.1f} a second"
    )
    if config.json is not None:
        records = [
            {"metric": "pictures", "value": sum(pictures), "unit": "1"},
            {"metric": "pictures_per_second", "value": new / seconds, "unit": "1/s"},
        ]
        write_results(config.json, records, command="generate", seed=config.seed)
