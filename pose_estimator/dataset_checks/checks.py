"""Runs all checks of a dataset: models, pairs, then each scene."""

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
from tqdm import tqdm

from ...core.images import read_image_size
from ..bop.dataset import read_dataset
from ..bop.fields import is_id
from ..bop.pairs import PAIRS_FILE, BopPair, read_entries
from ..bop.scene import Scene, read_scene
from .boxes import check_info
from .cameras import check_cameras, read_camera_size
from .config import CheckDataConfig
from .coverage import Coverage
from .files import check_files
from .findings import Findings
from .images import ImageCheck
from .meshes import EVALUATION, MODELS, CheckedModel, read_models
from .model_folders import check_folders
from .models import check_models
from .pairs import check_pairs, check_world
from .poses import check_poses
from .projection import Projection, explain, report

T = TypeVar("T")


def find_mistakes(
    config: CheckDataConfig, root: Path
) -> tuple[Findings, list[Projection], Coverage]:
    """Returns all findings, the wrong projections, and what was checked."""
    findings = Findings()
    models = _check_all_models(read_models(root, findings), findings)
    check = ImageCheck(models, read_camera_size(root, findings), findings)
    pairs = _read_pairs(root / PAIRS_FILE, findings)
    folders = _scene_folders(config, root, findings)
    check.coverage.objects = len(models)
    _check_scenes(config, folders, check, root / PAIRS_FILE, pairs)
    wrong = explain(check.suspects)
    report(wrong, findings)
    check.depth.report(findings)
    return findings, wrong, check.coverage


def _check_all_models(
    folders: Mapping[str, Mapping[int, CheckedModel]], findings: Findings
) -> dict[int, CheckedModel]:
    """Checks the folders of models; returns the objects, where possible those with colors."""
    models, evaluation = folders.get(MODELS), folders.get(EVALUATION)
    if models is not None:
        check_models(models.values(), findings)
    if evaluation is not None:
        check_models(evaluation.values(), findings, colored=models is None)
    if models and evaluation:
        check_folders(models, evaluation, findings)
    return {**(evaluation or {}), **(models or {})}


def _read_pairs(path: Path, findings: Findings) -> dict[int, BopPair]:
    """Returns position -> pair of the dataset's list of pairs, where it has one."""
    if not path.is_file():
        return {}
    before = findings.count()
    pairs = read_entries(path, findings.error)
    if not pairs and findings.count() == before:
        findings.warning(
            path, "pairs", "is empty", remedy="remove the file: pairs are then computed"
        )  # fmt: skip
    return pairs


def _scene_folders(
    config: CheckDataConfig, root: Path, findings: Findings
) -> dict[str, list[Path]]:
    """Returns split -> folders of its scenes."""
    names = [config.split] if config.split is not None else sorted(
        folder.name
        for folder in root.iterdir()
        if folder.is_dir() and any(p.is_dir() and is_id(p.name) for p in folder.iterdir())
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
            cause="this is a parent or a subfolder of the dataset's folder",
            remedy="pass the folder with models and test",
        )  # fmt: skip
    return found


def _check_scenes(
    config: CheckDataConfig, folders: dict[str, list[Path]], check: ImageCheck,
    pairs_path: Path, pairs: Mapping[int, BopPair],
) -> None:  # fmt: skip
    """Checks all scenes."""
    # Each scene with its number of images to check: 0 = all, -1 = none.
    work: list[tuple[Path, int]] = []
    for scenes in folders.values():
        looked = set(_spread(scenes, config.images))
        share = -(-config.images // max(1, len(scenes))) if config.images else 0
        work += [(folder, share if folder in looked else -1) for folder in scenes]
    paired = _split_of_pairs(pairs_path, pairs, check.findings)
    with tqdm(total=sum(_expected(*job) for job in work), desc="checking", unit="image") as bar:
        for number, (folder, share) in enumerate(work, start=1):
            bar.set_postfix_str(f"scene {number} of {len(work)}")
            scene = read_scene(folder, int(folder.name), check.findings.error)
            if scene is None:
                continue
            check.coverage.add(scene)
            reliable = _check_scene(scene, share, check, bar)
            if reliable is not None:
                check_world(scene, reliable, check.findings)
                if folder.parent == paired:
                    own = {n: p for n, p in pairs.items() if p.scene_id == scene.scene_id}
                    check_pairs(pairs_path, own, scene, check.models, reliable, check.findings)


def _split_of_pairs(path: Path, pairs: Mapping[int, BopPair], findings: Findings) -> Path | None:
    """Returns the split whose scenes the pairs name; `test` where there are several."""
    splits = sorted(
        {p.parent for p in path.parent.glob("*/*") if p.is_dir() and is_id(p.name)},
        key=lambda split: (split.name != "test", split.name),
    )
    scenes = {pair.scene_id for pair in pairs.values()}
    there = {split: {int(p.name) for p in split.iterdir() if is_id(p.name)} for split in splits}
    if not splits or not scenes:
        return None
    best = min(splits, key=lambda split: len(scenes - there[split]))
    for number, pair in pairs.items():
        if pair.scene_id not in there[best]:
            findings.error(
                path, "scene_id", "the pair's scene does not exist",
                detail=f"pair {number}: {best.name} has no scene {pair.scene_id}",
                remedy="remove the pair, or restore the scene",
            )  # fmt: skip
    return best


def _expected(folder: Path, share: int) -> int:
    """Returns the number of images of a scene to check, for the progress bar."""
    if share < 0:
        return 0
    count = sum(len(list((folder / name).glob("*"))) for name in ("rgb", "gray"))
    return min(count, share) if share else count


def _check_scene(scene: Scene, share: int, check: ImageCheck, bar: tqdm) -> np.ndarray | None:
    """Checks files, numbers and a sample of images.

    Returns:
        Which annotations are reliable, bool (N,); None where most projections are wrong.
    """
    findings = check.findings
    check_files(scene, findings)
    valid, reliable = check_poses(scene, check.models, findings)
    size = _size(scene)
    check_cameras(scene, size, findings)
    check_info(scene, size, findings)
    images = [i for i in scene.image_id.tolist() if i in scene.images]
    wrong = compared = 0
    for image_id in _spread(images, share) if share >= 0 else []:
        counts = check.check(scene, image_id, valid)
        wrong, compared = wrong + counts[0], compared + counts[1]
        bar.update()
    if 2 * wrong > compared:
        check.coverage.skipped += 1
        return None
    return reliable


def _size(scene: Scene) -> tuple[int, int] | None:
    """Returns height and width of the first readable image."""
    for path in list(scene.images.values())[:20]:
        try:
            return read_image_size(path)
        except (OSError, ValueError):
            continue
    return None


def _spread(items: list[T], count: int) -> list[T]:
    """Returns at most ``count`` of the items, evenly spread; 0 = all."""
    if not 0 < count < len(items):
        return items
    return [items[i * len(items) // count] for i in range(count)]
