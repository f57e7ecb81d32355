"""Renders scenes for training and testing estimators, and writes them in BOP format.

One BOP scene is one arrangement of objects, seen by several cameras, see ``scene_plan``. A scene
depends only on the seed and its number, so neither the number of workers nor a restart changes a
byte.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from tqdm import tqdm

from ...core.results import versions, write_results
from ...core.worker_pool import run_scenes
from ...pose_estimator.bop.dataset import read_dataset
from ...pose_estimator.bop.manifest import MANIFEST_FILE
from ...pose_estimator.bop.models import write_evaluation_models, write_models
from ...pose_estimator.bop.pairs import PAIRS_FILE
from ...pose_estimator.bop.targets import TARGETS_FILE, is_test, write_targets
from ...pose_estimator.bop.writer import scene_folder, write_camera, write_pairs
from ..simulation.intrinsics import scaled_intrinsics
from .checksums import SUMS_FILE, verify, write_dataset_sums
from .config import GenerateConfig
from .dataset_folder import check_or_write_manifest, remove_leftovers
from .pair_list import two_view_pairs
from .scene_plan import dataset_objects, plan_scene, target_names

IGNORED_SETTINGS = frozenset(
    ("out", "scenes", "workers", "worker_memory", "shard", "coco", "verify", "json")
)
"""Settings that do not change the content of a scene."""

_ONLY_WITH = {
    "gaps": ("hand-held", "mixed"),
    "references": ("hand-held", "mixed"),
    "stereo_baseline": ("stereo",),
}
"""Settings that only some samplings use."""


def generate(config: GenerateConfig) -> int:
    """Writes models and camera, renders the scenes that are missing, then lists their pairs.

    Returns:
        The exit code: 1 if ``config.verify`` is set and finds problems, else 0.

    Raises:
        InputError: if the folder was made with other settings, or an object is unknown.
        GraphicsUnavailable: if there is no OpenGL to render with.
        ChildProcessError: if several workers die on one scene.
    """
    if config.verify:
        return min(1, verify(config.out))
    from .scene_writer import SceneWriter, is_finished  # imports the simulator

    objects = dataset_objects(config)
    write_manifest(config, tuple(objects))
    (config.out / SUMS_FILE).unlink(missing_ok=True)  # it marks a finished run
    size = (config.height, config.width)
    write_models(config.out, objects.values())
    write_evaluation_models(config.out, objects.values())
    write_camera(config.out, scaled_intrinsics(size, "stretch"), size)
    part, parts = config.shard
    ids = range(part, config.scenes, parts)
    missing = [i for i in ids if not scene_folder(config.out, config.split, i).exists()]
    unfinished = [i for i in ids if not is_finished(config, i)]
    start = time.perf_counter()
    with tqdm(total=len(ids), initial=len(ids) - len(unfinished), unit="scene") as bar:
        task = partial(SceneWriter, config)
        for _ in run_scenes(task, unfinished, config.workers, config.worker_memory):
            bar.update()
    if parts == 1:
        _write_lists(config)
    _report(config, tuple(objects), ids, missing, time.perf_counter() - start)
    return 0


def write_manifest(config: GenerateConfig, object_names: tuple[str, ...]) -> None:
    """Writes manifest.json, or checks an existing one; the distractors' names come last.

    Raises:
        InputError: if the folder was made with other settings.
    """
    targets = target_names(config, object_names)
    settings: dict[str, Any] = asdict(config)
    settings |= {"objects": targets, "distractors": object_names[len(targets) :]}
    unused = {name for name, kinds in _ONLY_WITH.items() if config.sampling not in kinds}
    unused |= {"unit"} if config.unit == "auto" else set()
    check_or_write_manifest(
        config.out / MANIFEST_FILE,
        {k: v for k, v in settings.items() if k not in IGNORED_SETTINGS | unused},
        {"scenes": config.scenes, "versions": versions(), "checksums": SUMS_FILE},
    )


def _write_lists(config: GenerateConfig) -> None:
    """Writes the pairs, targets and checksums of the finished scenes."""
    out = config.out
    write_pairs(out / PAIRS_FILE, two_view_pairs(config))
    if is_test(config.split):
        write_targets(read_dataset(out, config.split), range(config.scenes))
    remove_leftovers(out, out / "models", out / "models_eval")
    files = [MANIFEST_FILE, "camera.json", PAIRS_FILE, TARGETS_FILE, "models", "models_eval"]
    write_dataset_sums(out, config.split, files)


def _report(
    config: GenerateConfig,
    names: Sequence[str],
    scene_ids: Sequence[int],
    made: Sequence[int],
    seconds: float,
) -> None:
    """Prints the number of images and their rate; writes the results file."""
    images = {i: len(plan_scene(config, i, names).frames) for i in scene_ids}
    total, new = sum(images.values()), sum(images[i] for i in made)
    print(
        f"{len(scene_ids)} scenes, {total} images in {config.out / config.split}; "
        f"{new} rendered now, {new / seconds:.1f} per second"
    )
    if config.json is not None:
        records = [
            {"metric": "images", "value": total, "unit": "1"},
            {"metric": "images_per_second", "value": new / seconds, "unit": "1/s"},
        ]
        write_results(config.json, records, command="generate", seed=config.seed)
