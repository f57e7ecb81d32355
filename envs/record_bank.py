"""The verb ``record-bank``: every candidate second view of many scenes, estimated once.

Each scene is a file of its own until all are there, so a killed run goes on where it was; then they
become one file. A scene depends on the seed and its number alone: neither the number of workers nor
a restart changes anything in it.
"""

from __future__ import annotations

import io
import json
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from ..pose_estimator.device import check_device
from .scene_kinds import SceneKindName

if TYPE_CHECKING:
    from .bank_recorder import BankRecorder
    from .view_bank import BankHeader, ViewBank


@dataclass(frozen=True)
class RecordBankConfig:
    """Record what every second view of many scenes leads to. Run it again after a kill."""

    out: Path
    """The bank, an .npz file."""
    scenes: int = 1000
    """Number of scenes; 24 second views each."""
    scene: SceneKindName = "occlusion"
    """Light clutter, heavy clutter, the target between tall things, or in a heap of objects."""
    seed: int = 0
    """Seed of the scenes: scene i is episode i of `evaluate-agent --seed`."""
    objects: tuple[str, ...] = ()
    """Names of objects or mesh files; by default the 13 of LineMOD."""
    estimator: str = "mid"
    """What estimates the pose: `mid`, `single`, or a .safetensors file of your own for `mid`."""
    pose_noise: tuple[float, float] | None = None
    """Standard deviations, degrees and metres, of the error in the relative camera pose that the
    estimator is told; none = told exactly."""
    answers: bool = True
    """Ask the estimator about every second view. If not, only what is visible from each is
    recorded, in a tenth of the time: more scenes from which `--algo greedy` learns to see."""
    data: Path | None = None
    """Instead of simulated scenes: a BOP dataset of real photographs. Each slot then holds the
    photograph whose direction from the object is nearest to the candidate's."""
    split: str = "test"
    """Split of that dataset."""
    pairs: Path | None = None
    """Its list of pairs of views; by default its own, or what can be found from the poses."""
    weights: str = "lmo"
    """Weights for that dataset: a name or a file."""
    device: str = "auto"
    """Where networks run: `auto` (a GPU where there is one, else the processor), `cpu`, `cuda`,
    `cuda:N` or `mps`."""
    workers: int = 2
    """Processes that record."""
    worker_memory: float = 2.5
    """Gigabytes from which on a worker is replaced by a fresh one; 0: never."""
    verify: bool = False
    """Only check that the file is whole, and say what it holds."""

    def __post_init__(self) -> None:
        for name in ("scenes", "workers"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.seed < 0:
            raise ValueError(f"seed must be at least 0, got {self.seed}")
        if self.out.suffix != ".npz":
            raise ValueError(f"out must be an .npz file, got {self.out}")

    @property
    def parts(self) -> Path:
        """Folder of the scenes of a run that is not finished."""
        return self.out.with_name(f"{self.out.name}.parts")

    @property
    def environment_arguments(self) -> dict[str, Any]:
        """What the environment is made with."""
        arguments: dict[str, Any] = {
            "scene": self.scene,
            "estimator": self.estimator,
            "device": self.device,
        }
        if self.pose_noise is not None:
            arguments["pose_noise"] = self.pose_noise
        return arguments | ({"objects": list(self.objects)} if self.objects else {})

    def maker(self) -> BankRecorder:
        """What records scenes in a worker."""
        from .bank_recorder import BankRecorder

        return BankRecorder(self)


def record_bank(config: RecordBankConfig) -> None:
    """Records the scenes that are missing and writes the bank.

    Raises:
        ValueError: if the file or the folder of its parts is of another bank, or is damaged, or
            there is no such device.
        GraphicsUnavailable: if there is no OpenGL to draw with.
    """
    from .view_bank import read_bank

    if config.out.exists() or config.verify:
        bank = read_bank(config.out)
        if not config.verify:
            _check_same(bank.header, config)
        describe(config.out, bank)
        return
    check_device(config.device)
    if config.data is not None:
        from .real_bank import record_real_bank

        record_real_bank(config)
    else:
        _record_scenes(config)
    describe(config.out, read_bank(config.out))


def _record_scenes(config: RecordBankConfig) -> None:
    from .view_bank import joined, write_bank

    config.parts.mkdir(parents=True, exist_ok=True)
    _claim(config)
    missing = [i for i in range(config.scenes) if not part_path(config, i).exists()]
    bar = tqdm(total=config.scenes, initial=config.scenes - len(missing), unit="scene")
    start = time.perf_counter()
    with bar:
        for _ in _make(config, missing):
            bar.update()
    if missing:
        seconds = time.perf_counter() - start
        print(f"{len(missing)} scenes in {seconds:.0f} s, {seconds / len(missing):.2f} s each")
    parts = [read_part(part_path(config, i)) for i in range(config.scenes)]
    write_bank(config.out, joined(make_header(config), parts))
    shutil.rmtree(config.parts)


def _make(config: RecordBankConfig, scene_ids: Sequence[int]) -> Iterator[int]:
    """Records the scenes and yields the number of each that is ready."""
    from . import worker_pool

    if config.workers > 1 and len(scene_ids) > 1:
        yield from worker_pool.make_scenes(config, scene_ids)
    else:
        recorder = config.maker()
        for scene_id in scene_ids:
            recorder.make(scene_id)
            yield scene_id


def part_path(config: RecordBankConfig, scene_id: int) -> Path:
    """The file of one scene of a run that is not finished."""
    return config.parts / f"{scene_id:06d}.npz"


def read_part(path: Path) -> dict[str, np.ndarray]:
    """The arrays of one scene."""
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def write_part(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Writes the arrays of one scene; the path holds all of it or nothing."""
    from ..pose_estimator.results import write_atomically

    stream = io.BytesIO()
    stored: dict[str, Any] = dict(arrays)
    np.savez_compressed(stream, **stored)
    write_atomically(path, stream.getvalue())


def make_header(config: RecordBankConfig) -> BankHeader:
    """What a bank of simulated scenes says about itself."""
    from ..assets import load_objects
    from .two_view_pose import CANDIDATE_VIEWS
    from .view_bank import BankHeader

    objects = load_objects(list(config.objects) or None)
    return BankHeader(
        source="simulation",
        scene=config.scene,
        object_names=tuple(objects),
        diameters=tuple(float(model.diameter) for model in objects.values()),
        candidate_views=CANDIDATE_VIEWS,
        estimator=config.estimator,
        seed=config.seed,
        settings={} if config.pose_noise is None else {"pose_noise": config.pose_noise},
    )


def describe(path: Path, bank: ViewBank) -> None:
    """Prints what the bank of a file holds."""
    header, right = bank.header, bank.second_error < 0.1
    print(
        f"{path}: {len(bank)} scenes ({header.source}, {header.scene}) of "
        f"{len(np.unique(bank.object_index))} objects x {bank.slots} second views by "
        f"{header.estimator}, {path.stat().st_size / 1e6:.1f} MB, checksum fits"
    )
    if not bank.answered:
        print(f"visible from the second views: {np.nanmean(bank.second_visibility):.0%} on average")
        return
    print(
        f"ADD(-S) < 0.1 d: first view {np.mean(bank.first_error < 0.1):.1%}, a random second view "
        f"{right.mean():.1%}, the best {right.any(axis=1).mean():.1%}"
    )


def _settings(config: RecordBankConfig) -> dict[str, Any]:
    aside = ("out", "scenes", "device", "workers", "worker_memory", "verify")
    return {
        k: v
        for k, v in json.loads(json.dumps(asdict(config), default=str)).items()
        if k not in aside
    }


def _claim(config: RecordBankConfig) -> None:
    """Says whose parts a folder holds, or checks it."""
    from ..pose_estimator.results import write_atomically

    path, settings = config.parts / "settings.json", _settings(config)
    if not path.exists():
        write_atomically(path, (json.dumps(settings, indent=1) + "\n").encode())
        return
    before = json.loads(path.read_text())
    changed = [name for name in settings if before.get(name) != settings[name]]
    if changed:
        raise ValueError(
            f"{config.parts} holds scenes of another bank, with other {', '.join(changed)}: give "
            "another --out, or delete the folder"
        )


def _check_same(header: BankHeader, config: RecordBankConfig) -> None:
    """Refuses to take a finished bank of other scenes for this one."""
    same = header.seed == config.seed and header.estimator == config.estimator
    same &= header.settings.get("pose_noise") == config.pose_noise
    if config.data is None and not (same and header.scene == config.scene):
        raise ValueError(
            f"{config.out} is a bank of other scenes ({header.source}, {header.scene}, seed "
            f"{header.seed}, {header.estimator}): give another --out"
        )
