"""Does memory stay flat while the generator renders? Thousands of frames in one process.

``python tests/helpers/soak_memory.py --frames 5000`` makes scenes of all kinds with one
``SceneWriter``, each with depth, masks and annotations, and throws the files away. It is no test:
how long it takes and what the driver keeps differ between machines. What is a leak shows in the
slope after the warm-up, in which three worlds are compiled. Memory may grow in steps of some
megabytes, whose place in the run sways the slope: look at the curve too.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np
from two_view_pose.core.memory import release_unused_memory
from two_view_pose.core.worker_pool import memory_in_use, single_thread_env
from two_view_pose.envs.datagen.generate import GenerateConfig

VIEWS = 4


def slope(frames: np.ndarray, memory: np.ndarray) -> float:
    """Growth of memory in kB (1000 bytes) per 1,000 frames: the least-squares line's.

    Args:
        frames: how many had been made at each measurement, (N,).
        memory: bytes held then, (N,).

    Raises:
        ValueError: if there are fewer than two different numbers of frames.
    """
    if len(np.unique(frames)) < 2:
        raise ValueError(f"a slope needs two measurements, got frames {list(frames)}")
    per_frame, _ = np.polyfit(np.asarray(frames, float), np.asarray(memory, float), 1)
    return float(per_frame)  # bytes a frame are kB per 1,000 frames


def summary(frames: np.ndarray, memory: np.ndarray, warm_up: int) -> dict[str, float]:
    """What the curve says after the first ``warm_up`` frames; memory in MB, slope in kB.

    Raises:
        ValueError: as :func:`slope`, for what is left of the measurements.
    """
    late = np.asarray(frames) >= warm_up
    kept = np.asarray(memory)[late]
    growth = slope(np.asarray(frames)[late], kept)
    return {
        "first_mb": kept[0] / 1e6,
        "last_mb": kept[-1] / 1e6,
        "maximum_mb": kept.max() / 1e6,
        "slope_kb_per_1000_frames": growth,
    }


def soak(options: argparse.Namespace, folder: Path, frames: list[int], memory: list[int]) -> None:
    """Makes scenes; adds numbers of frames, and the bytes held when these had been made."""
    import cv2
    from two_view_pose.envs.datagen.scene_writer import SceneWriter
    from two_view_pose.pose_estimator.bop.writer import scene_folder

    cv2.setNumThreads(1)
    scenes = -(-options.frames // VIEWS)
    config = GenerateConfig(
        folder / "set",
        scenes=scenes,
        views=VIEWS,
        scene="all",
        depth=True,
        width=options.width,
        height=options.height,
        seed=options.seed,
    )
    start = time.perf_counter()
    with single_thread_env(), closing(SceneWriter(config)) as writer:  # as in a worker
        for scene_id in range(scenes):
            writer.make(scene_id)
            release_unused_memory()
            shutil.rmtree(scene_folder(config.out, config.split, scene_id))
            made = VIEWS * (scene_id + 1)
            if made // options.every > (made - VIEWS) // options.every:
                frames.append(made)
                memory.append(memory_in_use())
                pace = made / (time.perf_counter() - start)
                print(f"{made:6} frames  {memory[-1] / 1e6:7.1f} MB  {pace:.1f}/s", flush=True)


def draw_curve(path: Path, frames: list[int], memory: list[int], warm_up: int) -> None:
    """Writes the curve as a small PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 2.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(frames, np.asarray(memory) / 1e6)
    axes.axvspan(0, warm_up, color="0.9", label="warm-up")
    axes.set(xlabel="frames", ylabel="memory held, MB", xlim=(0, frames[-1]), ylim=(0, None))
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=100)


def main() -> None:
    """Reads the options, soaks, prints and writes what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=5000, help="how many to render")
    parser.add_argument("--every", type=int, default=100, help="frames between measurements")
    parser.add_argument("--warm-up", type=int, default=1500, help="frames that do not count")
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=480)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the summary and the curve here")
    parser.add_argument("--figure", type=Path, help="draw the curve into this PNG")
    options = parser.parse_args()
    frames: list[int] = []
    memory: list[int] = []
    # Ctrl-C ends it early, with the summary of what there is.
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(KeyboardInterrupt):
        soak(options, Path(folder), frames, memory)
    found = summary(np.array(frames), np.array(memory), options.warm_up)
    for name, value in found.items():
        print(f"{name}: {value:.1f}")
    if options.json is not None:
        size = {"width": options.width, "height": options.height, "warm_up": options.warm_up}
        curve = {"frames": frames, "bytes": memory}
        options.json.write_text(json.dumps({**found, **size, **curve}, indent=1) + "\n")
    if options.figure is not None:
        draw_curve(options.figure, frames, memory, options.warm_up)


if __name__ == "__main__":
    main()
