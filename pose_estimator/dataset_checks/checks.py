"""All checks of a dataset: its models and pairs, then scene after scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
from tqdm import tqdm

from ...core.images import read_image_size
from ..bop.dataset import read_dataset
from ..bop.pairs import PAIRS_FILE, BopPair, read_entries
from ..bop.scene import Scene, read_scene
from .boxes import check_info
from .cameras import check_cameras, read_camera_size
from .config import CheckDataConfig
from .files import check_files
from .findings import Findings
from .images import ImageCheck
from .meshes import read_models
from .models import check_models
from .pairs import check_pairs, check_world
from .poses import check_poses
from .projection import Projection, explain, report

T = TypeVar("T")


def find_mistakes(config: CheckDataConfig, root: Path) -> tuple[Findings, list[Projection], str]:
    """All findings, the wrong projections, and what was looked at in words."""
    findings = Findings()
    models = read_models(root, findings)
    check_models(models.values(), findings)
    check = ImageCheck(models, read_camera_size(root, findings), findings)
    pairs = _read_pairs(root / PAIRS_FILE, findings)
    folders = _scene_folders(config, root, findings)
    read = _check_scenes(config, folders, check, root / PAIRS_FILE, pairs)
    wrong = explain(check.suspects)
    report(wrong, findings)
    check.depth.report(findings)
    summary = (
        f"{counted(len(models), 'object')}, {counted(read, 'scene')}; looked at "
        f"{counted(check.looked, 'image')}, compared {counted(check.projected, 'projection')}"
    )
    if check.set_aside:
        summary += (
            f"\nCamera poses and pairs of {counted(check.set_aside, 'scene')} were not compared "
            "with the objects, most of whose poses are wrong: correct these first, and check again"
        )
    return findings, wrong, summary


def counted(number: int, noun: str) -> str:
    """Such as "1 scene" and "2 scenes"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _read_pairs(path: Path, findings: Findings) -> dict[int, BopPair]:
    """The pairs of the dataset by their position in its list, where it has one."""
    if not path.is_file():
        return {}
    before = findings.count()
    pairs = read_entries(path, findings.error)
    if not pairs and findings.count() == before:
        findings.warning(
            path, "pairs", "there are none", remedy="remove the file: pairs are then found"
        )  # fmt: skip
    return pairs


def _scene_folders(
    config: CheckDataConfig, root: Path, findings: Findings
) -> dict[str, list[Path]]:
    """The scenes' folders of each split."""
    names = [config.split] if config.split is not None else sorted(
        folder.name
        for folder in root.iterdir()
        if folder.is_dir() and any(p.is_dir() and p.name.isdigit() for p in folder.iterdir())
    )  # fmt: skip
    found = {}
    for name in names:
        try:
            scene_ids = read_dataset(root, name).scene_ids
        except ValueError as error:
            findings.error(root / name, "folder", "holds no scenes", detail=str(error))
            continue
        found[name] = _spread([root / name / f"{i:06d}" for i in scene_ids], config.scenes)
    if not names:
        findings.error(
            root, "folder", "the dataset has no scenes",
            detail="no folder such as test/000001",
            cause="this is the folder above or below the dataset's",
            remedy="give the folder that holds models and test",
        )  # fmt: skip
    return found


def _check_scenes(
    config: CheckDataConfig, folders: dict[str, list[Path]], check: ImageCheck,
    pairs_path: Path, pairs: Mapping[int, BopPair],
) -> int:  # fmt: skip
    """Reads scene after scene; returns how many could be read."""
    # Each scene with its share of the images to look at: 0 = all, -1 = none.
    work: list[tuple[Path, int]] = []
    for scenes in folders.values():
        looked = set(_spread(scenes, config.images))
        share = -(-config.images // max(1, len(scenes))) if config.images else 0
        work += [(folder, share if folder in looked else -1) for folder in scenes]
    read = 0
    paired = _split_of_pairs(pairs_path, pairs, check.findings)
    with tqdm(total=sum(_expected(*job) for job in work), desc="checking", unit="image") as bar:
        for number, (folder, share) in enumerate(work, start=1):
            bar.set_postfix_str(f"scene {number} of {len(work)}")
            scene = read_scene(folder, int(folder.name), check.findings.error)
            if scene is None:
                continue
            read += 1
            believed = _check_scene(scene, share, check, bar)
            if believed is not None:
                check_world(scene, believed, check.findings)
                if folder.parent == paired:
                    ours = {n: p for n, p in pairs.items() if p.scene_id == scene.scene_id}
                    check_pairs(pairs_path, ours, scene, check.models, believed, check.findings)
    return read


def _split_of_pairs(path: Path, pairs: Mapping[int, BopPair], findings: Findings) -> Path | None:
    """The split whose scenes the pairs name; `test` where there are several."""
    splits = sorted(
        {p.parent for p in path.parent.glob("*/*") if p.is_dir() and p.name.isdigit()},
        key=lambda split: (split.name != "test", split.name),
    )
    scenes = {pair.scene_id for pair in pairs.values()}
    there = {split: {int(p.name) for p in split.iterdir() if p.name.isdigit()} for split in splits}
    if not splits or not scenes:
        return None
    best = min(splits, key=lambda split: len(scenes - there[split]))
    for number, pair in pairs.items():
        if pair.scene_id not in there[best]:
            findings.error(
                path, "scene_id", "a pair names a scene that is not there",
                detail=f"pair {number}: {best.name} has no scene {pair.scene_id}",
                remedy="remove the pair, or restore the scene",
            )  # fmt: skip
    return best


def _expected(folder: Path, share: int) -> int:
    """How many images of a scene will be looked at, for the progress bar."""
    if share < 0:
        return 0
    count = sum(len(list((folder / name).glob("*"))) for name in ("rgb", "gray"))
    return min(count, share) if share else count


def _check_scene(scene: Scene, share: int, check: ImageCheck, bar: tqdm) -> np.ndarray | None:
    """Checks files, numbers and a sample of images.

    Returns:
        Which annotations can be believed, bool (N,); None where so many are wrong that they say
        nothing of cameras.
    """
    findings = check.findings
    check_files(scene, findings)
    whole, believed = check_poses(scene, check.models, findings)
    size = _size(scene)
    check_cameras(scene, size, findings)
    check_info(scene, size, findings)
    images = [i for i in scene.image_id.tolist() if i in scene.images]
    wrong = compared = 0
    for image_id in _spread(images, share) if share >= 0 else []:
        bad, all_of_them = check.look(scene, image_id, whole)
        wrong, compared = wrong + bad, compared + all_of_them
        bar.update()
    if 2 * wrong > compared:
        check.set_aside += 1
        return None
    return believed


def _size(scene: Scene) -> tuple[int, int] | None:
    """Height and width of the first image that opens."""
    for path in list(scene.images.values())[:20]:
        try:
            return read_image_size(path)
        except OSError:
            continue
    return None


def _spread(items: list[T], most: int) -> list[T]:
    """At most ``most`` of the items, evenly spread; 0 = all."""
    if not 0 < most < len(items):
        return items
    return [items[i * len(items) // most] for i in range(most)]
