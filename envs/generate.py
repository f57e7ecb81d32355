"""Renders scenes for training and testing estimators, and writes them in BOP format.

One BOP scene is one arrangement of objects, seen by several cameras. Either the first is the
reference view and the others stand 10 to 75 degrees from it around the target, or they are frames
of a hand-held camera's sequence. What a scene holds depends only on the seed and its number, so
neither the number of workers nor a restart changes a byte.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from tqdm import tqdm

if TYPE_CHECKING:
    from .scene_writer import SceneMaker

QUIET_THREADS = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "LP_NUM_THREADS": "0",  # llvmpipe draws in the worker itself: workers are the parallelism
}
"""What the workers' environment says unless the caller's own says otherwise."""


SceneKind = Literal["linemod", "occlusion", "heap", "mixed", "all"]
Sampling = Literal["sphere", "hand-held", "mixed"]


@dataclass(frozen=True)
class GenerateConfig:
    """Renders paired training or test data and writes it in BOP format.

    A run that was killed is finished by the same command. The folder can be read by anything that
    reads BOP, and by ``train-estimator --data`` and ``evaluate --data``.
    """

    out: Path
    """Folder of the dataset; made where missing."""
    scenes: int = 100
    """How many scenes (arrangements of objects)."""
    views: int = 4
    """Pictures of each scene, the first of them the reference view; of hand-held scenes, the frames
    of the sequence."""
    objects: tuple[str, ...] = ()
    """Names of our objects, mesh files or folders of them; empty: all thirteen. Each is the target
    equally often."""
    scene: SceneKind = "mixed"
    """Light clutter, heavy clutter, eight objects in a heap, the first two by turns, or all three
    by turns."""
    sampling: Sampling = "sphere"
    """Views spread over the sphere around the target, frames of a hand-held camera's path (1.5 to
    3 cm from one to the next), or both by turns; then the hand-held scenes are one reference view
    and a frame at each gap from it."""
    gaps: tuple[int, ...] = (1, 5, 10)
    """Hand-held: frames between the two views of a pair."""
    references: int = 0
    """Hand-held: how many frames of a sequence are reference views, spread evenly; frames that no
    pair needs are not rendered. 0: every frame that has followers at all gaps."""
    split: str = "train_pbr"
    """Name of the split's folder."""
    seed: int = 0
    """Same seed, same bytes; test data needs another seed than training data."""
    workers: int = 2
    """Processes that render."""
    width: int = 640
    """Width of the pictures in pixels; the camera is LineMOD's, scaled."""
    height: int = 480
    """Height of the pictures in pixels."""
    view_angles: tuple[float, float] = (10.0, 75.0)
    """Smallest and largest angle in degrees between the reference view and another, seen from the
    target."""
    pair_angles: tuple[float, float] = (10.0, 60.0)
    """Angles in degrees of the pairs that two_view_pairs.json lists."""
    depth: bool = False
    """Also write depth maps (16-bit PNG)."""
    depth_noise: bool = False
    """Depth maps as a Kinect would see them, with noise, steps and holes; otherwise exact ones."""
    masks: bool = True
    """Also write masks of the objects' visible pixels."""
    jpeg_quality: int = 92
    """Quality of the JPEG pictures, 1 to 100; 0 writes PNG."""
    randomize: bool = True
    """Random lights, textures, materials and sensor; otherwise one neutral look."""
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
        for name, allowed in (("scene", get_args(SceneKind)), ("sampling", get_args(Sampling))):
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
        if self.depth_noise and not self.depth:
            raise ValueError("depth_noise needs depth: without it no depth maps are written")
        if not 0 <= self.jpeg_quality <= 100:
            raise ValueError(f"jpeg_quality must be 0 to 100, got {self.jpeg_quality}")
        if not self.split or Path(self.split).name != self.split:
            raise ValueError(f"split must be the name of a folder, got {self.split!r}")


def generate(config: GenerateConfig) -> None:
    """Renders the scenes that are missing, then writes models, camera and pairs.

    Raises:
        ValueError: if the folder holds a dataset that was made with other settings, or an object
            is unknown.
        GraphicsUnavailable: if there is no OpenGL to draw with.
    """
    from ..assets import load_objects
    from ..pose_estimator.bop_writer import scene_folder, write_camera, write_models, write_pairs
    from ..pose_estimator.results import write_results
    from .pair_list import two_view_pairs
    from .scene_plan import plan_scene
    from .scene_writer import scaled_intrinsics

    objects = load_objects(config.objects or None)
    _claim_folder(config, tuple(objects))
    write_models(config.out, objects.values())
    write_camera(
        config.out, scaled_intrinsics(config.height, config.width), (config.height, config.width)
    )
    missing = [
        scene_id
        for scene_id in range(config.scenes)
        if not scene_folder(config.out, config.split, scene_id).exists()
    ]
    start = time.perf_counter()
    with tqdm(total=config.scenes, initial=config.scenes - len(missing), unit="scene") as bar:
        for _ in _make_scenes(config, missing):
            bar.update()
    write_pairs(config.out / "two_view_pairs.json", two_view_pairs(config))
    seconds = time.perf_counter() - start
    pictures = [len(plan_scene(config, i, tuple(objects)).frames) for i in range(config.scenes)]
    made = sum(pictures[i] for i in missing)
    print(
        f"{config.scenes} scenes, {sum(pictures)} pictures in {config.out / config.split}; "
        f"{made} pictures made now, {made / seconds:.1f} a second"
    )
    if config.json is not None:
        records = [
            {"metric": "pictures", "value": sum(pictures), "unit": "1"},
            {"metric": "pictures_per_second", "value": made / seconds, "unit": "1/s"},
        ]
        write_results(config.json, records, command="generate", seed=config.seed)


def _claim_folder(config: GenerateConfig, object_names: tuple[str, ...]) -> None:
    """Writes manifest.json, or checks that the one that is there says the same."""
    from ..pose_estimator.bop_writer import write_json
    from ..pose_estimator.results import versions

    settings: dict[str, Any] = asdict(config) | {"objects": object_names}
    aside = ["out", "workers", "scenes", "json"]  # none of these changes what a scene looks like
    if config.sampling == "sphere":
        aside += ["sampling", "gaps", "references"]
    settings = _as_json({k: v for k, v in settings.items() if k not in aside})
    path = config.out / "manifest.json"
    if path.exists():
        # What an older version did not know was as it is by default now.
        defaults = _as_json({f.name: f.default for f in fields(config) if f.name in settings})
        before = {"sampling": "sphere"} | defaults | json.loads(path.read_text())["settings"]
        wanted = settings | {"sampling": config.sampling}
        changed = [k for k in wanted if before.get(k) != wanted[k]]
        if changed:
            raise ValueError(
                f"{config.out} holds a dataset with other settings: "
                + ", ".join(f"{k} is {before.get(k)!r} there, {wanted[k]!r} here" for k in changed)
            )
    config.out.mkdir(parents=True, exist_ok=True)
    write_json(path, {"settings": settings, "scenes": config.scenes, "versions": versions()})


def _as_json(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings as they come back from a file: tuples become lists."""
    return json.loads(json.dumps(settings))


def _make_scenes(config: GenerateConfig, scene_ids: list[int]) -> Iterator[int]:
    """Makes the scenes and yields the number of each that is ready."""
    if config.workers == 1 or len(scene_ids) < 2:
        from .scene_writer import SceneMaker

        with SceneMaker(config) as maker:
            for scene_id in scene_ids:
                maker.make(scene_id)
                yield scene_id
        return
    added = {k: v for k, v in QUIET_THREADS.items() if k not in os.environ}
    os.environ.update(added)  # the workers inherit it
    pool = ProcessPoolExecutor(
        min(config.workers, len(scene_ids)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(config,),
    )
    try:
        futures: dict[Future[None], int] = {pool.submit(_make_one, i): i for i in scene_ids}
        for future in as_completed(futures):
            future.result()
            yield futures[future]
    finally:
        pool.shutdown(cancel_futures=True)
        for name in added:
            del os.environ[name]


_maker: SceneMaker | None = None


def _start_worker(config: GenerateConfig) -> None:
    """In a worker: makes ready to make scenes."""
    global _maker
    import cv2

    from .scene_writer import SceneMaker

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it and ends its workers
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    _maker = SceneMaker(config)


def _leave_with_parent() -> None:
    """Ends a worker whose parent was killed: its queue alone would keep it waiting for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _make_one(scene_id: int) -> None:
    assert _maker is not None
    _maker.make(scene_id)
