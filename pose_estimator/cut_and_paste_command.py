"""The verb ``cut-and-paste``: a dataset of pictures put together from the objects of another."""

from __future__ import annotations

import json as json_format
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from .bop import BopAnnotation, BopImage
    from .bop_writer import BopFrame
    from .pasted_picture import CutOut

_SUFFIXES = (".jpg", ".jpeg", ".png")


@dataclass(frozen=True)
class CutAndPasteCommand:
    """Cuts objects out of a BOP dataset by their masks and pastes them on other backgrounds.

    Each picture is a scene of its own. Nearer objects hide farther ones. An object is moved as if
    the camera had turned about its centre, which is exact, and its pose turns with it; there is no
    camera pose and no depth. A run that was killed is finished by the same command. The dataset
    trains the detector and the 2D features (`train-estimator --stages detector features`); it holds
    no pairs of views.
    """

    data: Path
    """BOP dataset to cut from, a folder or a name below $BOP_PATH; it needs masks of the visible
    pixels."""
    out: Path
    """Folder of the new dataset; made where missing."""
    images: int = 1000
    """How many pictures to make."""
    backgrounds: Path | None = None
    """Folder of pictures (.jpg, .png) to paste on. Without it frames of the dataset are pasted on:
    their own objects stay and are annotated, and only objects they do not show are added. Give a
    folder where the dataset shows objects that it does not annotate."""
    split: str = "train_pbr"
    """Folder of the scenes, in both datasets."""
    objects: tuple[int, int] = (3, 8)
    """Fewest and most objects that are pasted into a picture."""
    minimum_visibility: float = 0.8
    """Objects that are less visible in their source are not cut out."""
    move: bool = True
    """Let objects land anywhere; --no-move keeps each where it was in its source."""
    seed: int = 0
    """Same seed, same pictures."""
    json: Path | None = None
    """File for machine-readable results."""

    def __post_init__(self) -> None:
        if self.images < 1:
            raise ValueError(f"images must be at least 1, got {self.images}")
        if not 1 <= self.objects[0] <= self.objects[1]:
            raise ValueError(f"objects must rise from at least 1, got {self.objects}")
        if not 0 < self.minimum_visibility <= 1:
            raise ValueError(
                f"minimum_visibility must be above 0 and at most 1, got {self.minimum_visibility}"
            )
        if self.seed < 0:
            raise ValueError(f"seed must be at least 0, got {self.seed}")


def cut_and_paste(command: CutAndPasteCommand) -> None:
    """Makes the pictures that are missing.

    Raises:
        ValueError: if the dataset has no masks or nothing to cut out, there are no backgrounds, or
            the folder holds a dataset that was made with other settings.
    """
    import numpy as np
    from tqdm import tqdm

    from .bop import read_dataset
    from .bop_writer import scene_folder, write_scene
    from .find_dataset import find_dataset
    from .results import write_results

    command = replace(command, data=find_dataset(command.data))
    if command.out.resolve() == command.data.resolve():
        raise ValueError(f"out must be another folder than data, got {command.out} for both")
    images = list(read_dataset(command.data, command.split))
    sources = find_sources(images, command.minimum_visibility)
    if not sources:
        raise ValueError(
            f"{command.data} ({command.split}) shows no object with a mask that is "
            f"{command.minimum_visibility:.0%} visible"
        )
    pictures = [] if command.backgrounds is None else _find_pictures(command.backgrounds)
    if not pictures:
        images = [image for image in images if _missing(image, sources)]
    if not images:
        raise ValueError(
            "every frame of the dataset shows all its objects, so none can be added: give "
            "--backgrounds"
        )
    _claim(command)
    for name in ("models", "models_eval", "camera.json"):
        source = command.data / name
        if source.is_dir():
            shutil.copytree(source, command.out / name, dirs_exist_ok=True)
        elif source.is_file():
            shutil.copyfile(source, command.out / name)
    start, made = perf_counter(), 0
    for number in tqdm(range(command.images), unit="picture"):
        if not scene_folder(command.out, command.split, number).exists():
            rng = np.random.default_rng([command.seed, number])
            frame = make_picture(command, images, sources, pictures, rng)
            write_scene(command.out, command.split, number, [frame])
            made += 1
    seconds = perf_counter() - start
    print(
        f"{command.images} pictures in {command.out / command.split}; "
        f"{made} made now, {made / seconds:.1f} a second"
    )
    if command.json is not None:
        records = [{"metric": "pictures", "value": command.images, "unit": "1"}]
        write_results(command.json, records, command="cut-and-paste", seed=command.seed)


def find_sources(
    images: Sequence[BopImage], minimum_visibility: float
) -> dict[int, list[tuple[BopImage, BopAnnotation]]]:
    """What can be cut out: obj_id -> the pictures that show the object well, with its mask."""
    sources: dict[int, list[tuple[BopImage, BopAnnotation]]] = {}
    for image in images:
        for annotation in image.annotations:
            masked = annotation.mask_visib_path is not None and annotation.px_count_visib > 0
            if masked and annotation.visibility >= minimum_visibility:
                sources.setdefault(annotation.obj_id, []).append((image, annotation))
    return dict(sorted(sources.items()))


def make_picture(
    command: CutAndPasteCommand,
    images: Sequence[BopImage],
    sources: Mapping[int, Sequence[tuple[BopImage, BopAnnotation]]],
    pictures: Sequence[Path],
    rng: np.random.Generator,
) -> BopFrame:
    """One picture with its annotations.

    Args:
        command: how.
        images: frames of the dataset: one of them lends its camera, and its pixels where there are
            no ``pictures``; then each must lack an object.
        sources: what can be cut out.
        pictures: backgrounds.
        rng: source of randomness.
    """
    import numpy as np

    from .bop import read_mask, read_rgb
    from .input_files import read_image
    from .pasted_picture import compose, place_anywhere

    base = images[int(rng.integers(len(images)))]
    canvas = read_rgb(base)
    size = canvas.shape[0], canvas.shape[1]
    if pictures:
        free, shown = list(sources), []
        canvas = cover(read_image(pictures[int(rng.integers(len(pictures)))]), size, rng)
    else:
        free = _missing(base, sources)
        shown = [(annotation, read_mask(annotation)) for annotation in base.annotations]
    count = min(len(free), int(rng.integers(command.objects[0], command.objects[1] + 1)))
    pasted: list[tuple[CutOut, np.ndarray]] = []
    for obj_id in rng.choice(free, count, replace=False).tolist():
        cut = _cut_out(*sources[obj_id][int(rng.integers(len(sources[obj_id])))])
        turn = place_anywhere(cut, base.K, size, rng) if command.move else np.eye(3)
        pasted.append((cut, turn))
    return compose(canvas, base.K, shown, pasted)


def cover(picture: np.ndarray, size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """A random piece of a picture, mirrored or not, scaled to ``size`` (H, W)."""
    import cv2
    import numpy as np

    height, width = size
    largest = min(picture.shape[0] / height, picture.shape[1] / width)
    scale = largest * rng.uniform(0.6, 1.0)
    h, w = (max(1, int(side * scale)) for side in size)
    y = rng.integers(0, picture.shape[0] - h + 1)
    x = rng.integers(0, picture.shape[1] - w + 1)
    piece = picture[y : y + h, x : x + w]
    if rng.random() < 0.5:
        piece = piece[:, ::-1]
    way = cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
    return cv2.resize(np.ascontiguousarray(piece), (width, height), interpolation=way)


def _missing(image: BopImage, sources: Mapping[int, object]) -> list[int]:
    """The objects that could be added to a frame: those that it does not show."""
    shown = {annotation.obj_id for annotation in image.annotations}
    return [obj_id for obj_id in sources if obj_id not in shown]


def _cut_out(image: BopImage, annotation: BopAnnotation) -> CutOut:
    from .bop import read_mask, read_rgb
    from .pasted_picture import CutOut

    return CutOut(read_rgb(image), read_mask(annotation), image.K, annotation)


def _find_pictures(folder: Path) -> list[Path]:
    """The pictures below a folder."""
    found = sorted(p for p in folder.rglob("*") if p.suffix.lower() in _SUFFIXES)
    if not found:
        raise ValueError(f"backgrounds: {folder} holds no pictures ({', '.join(_SUFFIXES)})")
    return found


def _claim(command: CutAndPasteCommand) -> None:
    """Writes manifest.json, or checks that the one that is there says the same."""
    from .bop_writer import write_json
    from .results import versions

    settings = {k: v for k, v in asdict(command).items() if k not in ("out", "images", "json")}
    settings["data"] = command.data.name
    settings["backgrounds"] = None if command.backgrounds is None else command.backgrounds.name
    settings = json_format.loads(json_format.dumps(settings))
    path = command.out / "manifest.json"
    if path.exists():
        before = json_format.loads(path.read_text())["settings"]
        if before != settings:
            raise ValueError(
                f"{command.out} holds a dataset with other settings: {before}, not {settings}"
            )
    command.out.mkdir(parents=True, exist_ok=True)
    write_json(path, {"settings": settings, "scenes": command.images, "versions": versions()})
