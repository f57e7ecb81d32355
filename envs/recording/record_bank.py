"""The command ``record-bank``: records every candidate second view of many scenes.

Each scene is a file until all are recorded, so a killed run resumes; then they become one file. A
scene depends on the seed and its number only, not on the number of workers or on restarts.
"""

import shutil
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ...core.device import check_device
from ...core.errors import InputError
from ...core.worker_pool import run_scenes
from ..datagen.dataset_folder import check_or_write_manifest
from ..view_banks.bank import (
    BankHeader,
    ViewBank,
    concatenate,
    read_arrays,
    read_bank,
    write_bank,
)
from .config import RecordBankConfig

IGNORED_SETTINGS = frozenset(("out", "scenes", "device", "workers", "worker_memory", "verify"))
"""Options that do not change the recorded scenes."""


def record_bank(config: RecordBankConfig) -> None:
    """Records the missing scenes and writes the bank.

    Raises:
        InputError: if the file or the folder of its parts is of another bank, or corrupted, or
            there is no such device.
        GraphicsUnavailable: if there is no OpenGL.
    """
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
        record_scenes(config)
    describe(config.out, read_bank(config.out))


def record_scenes(config: RecordBankConfig) -> None:
    from .recorder import BankRecorder, make_header

    settings = {k: v for k, v in asdict(config).items() if k not in IGNORED_SETTINGS}
    check_or_write_manifest(config.parts / "settings.json", settings)
    missing = [i for i in range(config.scenes) if not config.part_path(i).exists()]
    start = time.perf_counter()
    with tqdm(total=config.scenes, initial=config.scenes - len(missing), unit="scene") as bar:
        task = partial(BankRecorder, config)
        for _ in run_scenes(task, missing, config.workers, config.worker_memory):
            bar.update()
    if missing:
        seconds = time.perf_counter() - start
        print(f"{len(missing)} scenes in {seconds:.0f} s, {seconds / len(missing):.2f} s each")
    write_bank(config.out, concatenate(make_header(config), _read_parts(config)))
    shutil.rmtree(config.parts)


def _read_parts(config: RecordBankConfig) -> list[dict[str, np.ndarray]]:
    """Reads the recorded scenes, which must have the same arrays."""
    paths = [config.part_path(i) for i in range(config.scenes)]
    try:
        parts = [read_arrays(path) for path in paths]
    except InputError as error:
        raise InputError(f"{error}; delete it, then run the same command again") from error
    shapes = [{key: a.shape[1:] for key, a in part.items()} for part in parts]
    for path, shape in zip(paths, shapes, strict=True):
        if shape != shapes[0]:
            raise InputError(
                f"{path} has other arrays than {paths[0].name}: delete {config.parts}, then run "
                "the same command again"
            )
    return parts


def describe(path: Path, bank: ViewBank) -> None:
    """Prints a summary of a bank."""
    header, success = bank.header, bank.second_error < 0.1
    print(
        f"{path}: {len(bank)} scenes ({header.source}, {header.scene}) of "
        f"{len(np.unique(bank.object_index))} objects x {bank.slots} second views by "
        f"{header.estimator}, {path.stat().st_size / 1e6:.1f} MB, checksum matches"
    )
    if not bank.has_estimates:
        print(f"mean visibility from the second views: {np.nanmean(bank.second_visibility):.0%}")
        return
    print(
        f"ADD(-S) < 0.1 d: first view {np.mean(bank.first_error < 0.1):.1%}, a random second view "
        f"{success.mean():.1%}, the best {success.any(axis=1).mean():.1%}"
    )


def _check_same(header: BankHeader, config: RecordBankConfig) -> None:
    """Checks that a finished bank has the scenes of ``config``."""
    same = header.seed == config.seed and header.estimator == config.estimator
    same &= header.settings.get("pose_noise") == config.pose_noise
    if config.data is None and not (same and header.scene == config.scene):
        raise InputError(
            f"{config.out} is a bank of other scenes ({header.source}, {header.scene}, seed "
            f"{header.seed}, {header.estimator}): give another --out"
        )
