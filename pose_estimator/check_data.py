"""The verb ``check-data``: what is wrong with a BOP dataset, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from tqdm import tqdm

    from .bop_raw import RawScene
    from .bop_raw_models import RawModel
    from .bop_raw_pairs import RawPair
    from .data_checks_pictures import PictureCheck
    from .data_checks_projection import Projection
    from .data_findings import Findings


@dataclass(frozen=True)
class CheckDataConfig:
    """Finds the usual mistakes in a BOP dataset: units, axes, quaternions, cameras, masks, files.

    All JSON files are read. Pictures, masks and depth maps are looked at in a sample, evenly spread
    over all scenes. Everything that is found is listed, equal findings in one row. The exit code is
    1 where there are errors, 0 where there are none or warnings alone.
    """

    data: Annotated[Path, tyro.conf.Positional]
    """The dataset: a folder in BOP's layout, or a name below $BOP_PATH."""
    split: str | None = None
    """Folder of the scenes, such as `test`; none = every folder that holds scenes."""
    scenes: int = 0
    """Most scenes of a split to read, evenly spread; 0 = all."""
    images: int = 1000
    """Most pictures of a split to look at, evenly spread; 0 = all. With its masks a picture takes
    about a tenth of a second, and longer where projections are wrong."""
    out: Path | None = None
    """Folder for overlay pictures of wrong projections."""
    pictures: int = 8
    """Most overlay pictures to draw."""
    json: Path | None = None
    """Write the findings as a results file."""

    def __post_init__(self) -> None:
        for name in ("scenes", "images", "pictures"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must be at least 0, got {getattr(self, name)}")


def check_data(config: CheckDataConfig) -> int:
    """Checks a dataset, prints what was found, and returns the exit code.

    Raises:
        ValueError: if there is no such dataset, or an option is wrong.
    """
    from rich.console import Console

    from .data_report import print_findings
    from .find_dataset import find_dataset
    from .results import write_results

    root = find_dataset(config.data)
    findings, wrong, summary = find_mistakes(config, root)
    console = Console(highlight=False)
    print_findings(findings, root, console)
    errors, warnings = findings.count("error"), findings.count("warning")
    console.print(f"{root}: {summary}", soft_wrap=True)
    console.print(f"{_counted(errors, 'error')}, {_counted(warnings, 'warning')}")
    if config.out is not None:
        for path in _draw(config, wrong):
            console.print(f"picture: {path}", soft_wrap=True)
    if config.json is not None:
        records = [
            {"metric": "errors", "value": errors, "unit": "1"},
            {"metric": "warnings", "value": warnings, "unit": "1"},
            *findings.records(),
        ]
        write_results(config.json, records, command=f"check-data {root.name}", seed=None)
    return int(errors > 0)


def find_mistakes(config: CheckDataConfig, root: Path) -> tuple[Findings, list[Projection], str]:
    """All findings, the wrong projections, and what was looked at in words."""
    from .bop_pairs import PAIRS_FILE
    from .bop_raw_models import read_raw_models
    from .bop_raw_pairs import read_raw_pairs
    from .data_checks_cameras import read_camera_size
    from .data_checks_models import check_models
    from .data_checks_pictures import PictureCheck
    from .data_checks_projection import explain, report
    from .data_findings import Findings

    findings = Findings()
    models = read_raw_models(root, findings)
    check_models(models.values(), findings)
    check = PictureCheck(models, read_camera_size(root, findings), findings)
    file = root / PAIRS_FILE
    pairs = read_raw_pairs(file, findings) if file.is_file() else []
    folders = _scene_folders(config, root, findings)
    read = _check_scenes(config, folders, models, check, file, pairs, findings)
    wrong = explain(check.suspects)
    report(wrong, findings)
    check.depth.report(findings)
    summary = (
        f"{_counted(len(models), 'object')}, {_counted(read, 'scene')}; looked at "
        f"{_counted(check.looked, 'picture')}, compared {_counted(check.projected, 'projection')}"
    )
    if check.set_aside:
        summary += (
            f"\nCamera poses and pairs of {_counted(check.set_aside, 'scene')} were not compared "
            "with the objects, most of whose poses are wrong: correct these first, and check again"
        )
    return findings, wrong, summary


def _scene_folders(
    config: CheckDataConfig, root: Path, findings: Findings
) -> dict[str, list[Path]]:
    """The scenes' folders of each split."""
    from .bop import read_dataset

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
    config: CheckDataConfig,
    folders: dict[str, list[Path]],
    models: dict[int, RawModel],
    check: PictureCheck,
    pairs_path: Path,
    pairs: list[RawPair],
    findings: Findings,
) -> int:
    """Reads scene after scene; returns how many could be read."""
    from tqdm import tqdm

    from .bop_raw import read_raw_scene

    work = []
    for scenes in folders.values():
        looked = set(_spread(scenes, config.images))
        share = -(-config.images // max(1, len(scenes))) if config.images else 0
        work += [(folder, share if folder in looked else -1) for folder in scenes]
    read = 0
    paired = _split_of_pairs(pairs_path, pairs, findings)
    of_scene: dict[int, list[RawPair]] = {}
    for pair in pairs:
        of_scene.setdefault(pair.scene_id, []).append(pair)
    expected = sum(_expected(folder, share) for folder, share in work)
    with tqdm(total=expected, desc="checking", unit="picture") as bar:
        for number, (folder, share) in enumerate(work, start=1):
            bar.set_postfix_str(f"scene {number} of {len(work)}")
            scene = read_raw_scene(folder, int(folder.name), findings)
            if scene is not None:
                ours = of_scene.get(scene.scene_id, []) if folder.parent == paired else []
                _check_scene(scene, share, models, check, (pairs_path, ours), findings, bar)
                read += 1
    return read


def _split_of_pairs(path: Path, pairs: list[RawPair], findings: Findings) -> Path | None:
    """The split whose scenes the pairs name; `test` where there are several."""
    splits = sorted(
        {p.parent for p in path.parent.glob("*/*") if p.is_dir() and p.name.isdigit()},
        key=lambda split: (split.name != "test", split.name),
    )
    scenes = {pair.scene_id for pair in pairs}
    there = {split: {int(p.name) for p in split.iterdir() if p.name.isdigit()} for split in splits}
    if not splits or not scenes:
        return None
    best = min(splits, key=lambda split: len(scenes - there[split]))
    for pair in pairs:
        if pair.scene_id not in there[best]:
            findings.error(
                path, "scene_id", "a pair names a scene that is not there",
                detail=f"pair {pair.number}: {best.name} has no scene {pair.scene_id}",
                remedy="remove the pair, or restore the scene",
            )  # fmt: skip
    return best


def _expected(folder: Path, share: int) -> int:
    """How many pictures of a scene will be looked at, for the progress bar."""
    if share < 0:
        return 0
    count = sum(len(list((folder / name).glob("*"))) for name in ("rgb", "gray"))
    return min(count, share) if share else count


def _check_scene(
    scene: RawScene,
    share: int,
    models: dict[int, RawModel],
    check: PictureCheck,
    pairs: tuple[Path, list[RawPair]],
    findings: Findings,
    bar: tqdm,
) -> None:
    from .data_checks_boxes import check_info
    from .data_checks_cameras import check_cameras
    from .data_checks_files import check_files
    from .data_checks_pairs import check_pairs, check_world
    from .data_checks_poses import check_poses

    check_files(scene, findings)
    whole, believed = check_poses(scene, models, findings)
    size = _size(scene)
    check_cameras(scene, size, findings)
    check_info(scene, size, findings)
    images = [i for i in scene.image_id.tolist() if i in scene.pictures]
    wrong = compared = 0
    for image_id in _spread(images, share) if share >= 0 else []:
        bad, all_of_them = check.look(scene, image_id, whole)
        wrong, compared = wrong + bad, compared + all_of_them
        bar.update()
    # Poses that are wrong themselves say nothing about cameras.
    if 2 * wrong > compared:
        check.set_aside += 1
        return
    check_world(scene, believed, findings)
    check_pairs(*pairs, scene, models, believed, findings)


def _size(scene: RawScene) -> tuple[int, int] | None:
    """Height and width of the first picture that opens."""
    from PIL import Image

    for path in list(scene.pictures.values())[:20]:
        try:
            with Image.open(path) as picture:
                return picture.height, picture.width
        except (OSError, ValueError, SyntaxError):
            continue
    return None


def _draw(config: CheckDataConfig, wrong: list[Projection]) -> list[Path]:
    """Writes the overlay pictures."""
    from .data_pictures import choose, draw, file_name

    assert config.out is not None
    config.out.mkdir(parents=True, exist_ok=True)
    paths = []
    for projection in choose(wrong, config.pictures):
        paths.append(config.out / file_name(projection))
        draw(projection, paths[-1])
    return paths


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _spread(items: list, most: int) -> list:
    """At most ``most`` of the items, evenly spread; 0 = all."""
    if not 0 < most < len(items):
        return items
    return [items[i * len(items) // most] for i in range(most)]
