"""Images per second of ``generate``, with all annotations, on two workers."""

from __future__ import annotations

import contextlib
import io
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from two_view_pose.envs.datagen.checksums import SUMS_FILE
from two_view_pose.envs.datagen.generate import GenerateConfig, generate
from two_view_pose.pose_estimator.bop.writer import scene_folder

from ..config import BenchConfig
from ..stopwatch import Record

GOAL = 8.0
"""Images a second."""

WORKERS = 2
VIEWS = 4


def measure(config: BenchConfig) -> Iterator[Record]:
    """Makes a small dataset of images of 640x480 in a temporary folder.

    RGB, depth, masks, silhouettes and all annotations; dense clutter; four images a scene.

    Yields:
        Two records of the results file, images a second. With start-up: from the call until
        everything is written. Without: from the moment when each worker could have made a scene
        until the last scene is finished.

    Raises:
        ValueError: if there are too few scenes to separate start-up.
    """
    scenes = config.scenes
    if scenes < 2 * WORKERS:
        raise ValueError(f"scenes must be at least {2 * WORKERS}, got {scenes}")
    with tempfile.TemporaryDirectory() as folder:
        generated = GenerateConfig(
            Path(folder) / "set",
            scenes=scenes,
            views=VIEWS,
            scene="clutter",
            depth=True,
            workers=WORKERS,
            seed=config.seed,
        )
        start = time.time()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            generate(generated)
        included = scenes * VIEWS / (time.time() - start)
        finished = finishing_times(generated)
    excluded = (scenes - WORKERS) * VIEWS / (finished[-1] - finished[WORKERS - 1])
    for startup, rate in (("included", included), ("excluded", excluded)):
        yield {
            "metric": "images_per_second",
            "value": rate,
            "unit": "1/s",
            "work": f"generate, all annotations, {WORKERS} workers, start-up {startup}",
            "startup": startup,
            "goal": GOAL,
            "n": scenes * VIEWS,
        }


def finishing_times(config: GenerateConfig) -> list[float]:
    """When each scene's last file was written, ascending, seconds of the epoch."""
    folders = [scene_folder(config.out, config.split, i) for i in range(config.scenes)]
    return sorted((folder / SUMS_FILE).stat().st_mtime_ns / 1e9 for folder in folders)
