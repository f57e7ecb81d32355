"""How many pictures a second ``generate`` makes, with all annotations, on two workers."""

from __future__ import annotations

import contextlib
import io
import tempfile
import time
from pathlib import Path
from typing import Any

from ..pose_estimator.bop_writer import scene_folder
from .checksums import SUMS_FILE
from .generate import GenerateConfig, generate

GOAL = 8.0
"""Pictures a second."""

WORKERS = 2
VIEWS = 4


def measure_generator(scenes: int, seed: int) -> list[dict[str, Any]]:
    """Makes a small dataset of pictures of 640x480 in a temporary folder.

    Pictures, depth, masks, silhouettes and all that is said of them; dense clutter.

    Args:
        scenes: how many; each has four pictures.
        seed: of the scenes.

    Returns:
        Two records of the results file, pictures a second. With start-up: from the call until
        everything is written. Without: from the moment when each worker could have made a scene
        until the last scene is finished.

    Raises:
        ValueError: if there are too few scenes to tell start-up apart.
    """
    if scenes < 2 * WORKERS:
        raise ValueError(f"scenes must be at least {2 * WORKERS}, got {scenes}")
    with tempfile.TemporaryDirectory() as folder:
        config = GenerateConfig(
            Path(folder) / "set",
            scenes=scenes,
            views=VIEWS,
            scene="clutter",
            depth=True,
            workers=WORKERS,
            seed=seed,
        )
        start = time.time()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            generate(config)
        included = scenes * VIEWS / (time.time() - start)
        finished = finishing_times(config)
    excluded = (scenes - WORKERS) * VIEWS / (finished[-1] - finished[WORKERS - 1])
    return [_record("included", included, scenes), _record("excluded", excluded, scenes)]


def finishing_times(config: GenerateConfig) -> list[float]:
    """When each scene's last file was written, ascending, seconds of the epoch."""
    folders = [scene_folder(config.out, config.split, i) for i in range(config.scenes)]
    return sorted((folder / SUMS_FILE).stat().st_mtime_ns / 1e9 for folder in folders)


def _record(startup: str, rate: float, scenes: int) -> dict[str, Any]:
    return {
        "metric": "pictures_per_second",
        "value": rate,
        "unit": "1/s",
        "work": f"generate, all annotations, {WORKERS} workers, start-up {startup}",
        "startup": startup,
        "goal": GOAL,
        "n": scenes * VIEWS,
    }
