"""Reads and writes BOP result files.

A CSV of the task "6D localization" since BOP Challenge 2019, with the columns of `HEADER`: R is
nine numbers in row-major order, t three numbers in millimeters, both separated by spaces
(https://bop.felk.cvut.cz/challenges/bop-challenge-2019/#formatofresults). BOP recommends names such
as ``METHOD_DATASET-SPLIT.csv``.
"""

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.files import write_atomically
from ...core.geometry import check_rigid
from ...core.text_files import read_text
from .fields import MM, Place, is_id, read_numbers, read_transforms, rigid

HEADER = "scene_id,im_id,obj_id,score,R,t,time"
_COLUMNS = HEADER.split(",")

UNKNOWN_TIME = -1.0
"""BOP's value of the column ``time`` where it was not measured."""


@dataclass(frozen=True, eq=False)
class BopResult:
    """One estimate: a row of the file.

    Attributes:
        score: confidence; only the order within a file is meaningful.
        T_cam_obj: object to camera, (4, 4), meters.
        seconds: run time for all objects of the image, or `UNKNOWN_TIME`.
    """

    scene_id: int
    image_id: int
    obj_id: int
    score: float
    T_cam_obj: np.ndarray
    seconds: float = UNKNOWN_TIME

    @property
    def target(self) -> tuple[int, int, int]:
        """Ids of scene, image and object."""
        return self.scene_id, self.image_id, self.obj_id


def write_bop_results(path: str | Path, results: Iterable[BopResult]) -> None:
    """Writes estimates with all digits, so that reading gives the same poses.

    Raises:
        InputError: if a pose is not rigid, or a score or a time is not finite.
    """
    lines = [HEADER]
    for result in results:
        scene_id, image_id, obj_id = result.target
        name = f"estimate of object {obj_id} in scene {scene_id}, image {image_id}"
        T = check_rigid(result.T_cam_obj, f"T_cam_obj of the {name}")
        if not (math.isfinite(result.score) and math.isfinite(result.seconds)):
            raise InputError(f"score and seconds of the {name} must be finite")
        cells = [str(number) for number in result.target]
        cells += [repr(float(result.score)), _numbers(T[:3, :3]), _numbers(T[:3, 3] * MM)]
        lines.append(",".join([*cells, repr(float(result.seconds))]))
    write_atomically(path, ("\n".join(lines) + "\n").encode())


def read_bop_results(
    path: str | Path,
    images: Mapping[int, Collection[int]] | None = None,
    obj_ids: Collection[int] | None = None,
) -> tuple[BopResult, ...]:
    """Reads a file of estimates in its order; the header is optional, as for bop_toolkit.

    Args:
        path: the file.
        images: scene id -> valid image ids; None accepts any.
        obj_ids: valid object ids; None accepts any.

    Raises:
        InputError: if the file or a row is invalid, a pose is not rigid, or an id is unknown; the
            message names file and line.
    """
    path = Path(path)
    try:
        lines = read_text(path).splitlines()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except InputError as error:
        raise InputError(f"{error}; estimates are a CSV: {HEADER}") from error
    if not any(line.strip() for line in lines):
        raise InputError(f"{path} is empty; a file without estimates holds the header {HEADER}")
    rows, places = [], []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or (number == 1 and line.replace(" ", "") == HEADER):
            continue
        place = Place(entry=f"line {number}")
        cells = line.split(",")
        if len(cells) != len(_COLUMNS):
            raise InputError(
                f"{path}, {place}: must have {len(_COLUMNS)} columns separated by commas "
                f"({HEADER}), got {len(cells)}; the numbers of R and t are separated by spaces"
            )
        rows.append(dict(zip(_COLUMNS, cells, strict=True)))
        places.append(place)
    poses = [{"R": row["R"].split(), "t": row["t"].split()} for row in rows]
    T_cam_obj = read_transforms(poses, ("R", "t"), path, places)
    rigid(T_cam_obj, lambda i: f"{path}, {places[i]}: field 'R'")
    score, seconds = (
        read_numbers(rows, name, 1, path, places, max_value=math.inf)[:, 0]
        for name in ("score", "time")
    )
    results = []
    for i, row in enumerate(rows):
        where = f"{path}, {places[i]}"
        scene_id = _id(row["scene_id"], images, f"{where}: scene_id", "scenes")
        of_scene = None if images is None else images[scene_id]
        image_id = _id(row["im_id"], of_scene, f"{where}: im_id", f"scene {scene_id}")
        ids = scene_id, image_id, _id(row["obj_id"], obj_ids, f"{where}: obj_id", "objects")
        results.append(BopResult(*ids, float(score[i]), T_cam_obj[i], float(seconds[i])))
    return tuple(results)


def most_confident_per_target(
    estimates: Iterable[tuple[BopResult, float]],
) -> list[BopResult]:
    """Selects the estimate of lowest uncertainty per scene, image and object.

    BOP expects one estimate per object and image; ours has one per second view. The scores do not
    discriminate: they are the detector's in the reference view, which all of them share.

    Args:
        estimates: each with its uncertainty (any unit); ``seconds`` are those of the one estimate.

    Returns:
        In order of the targets' first occurrence; the first of equal uncertainty. ``seconds`` are
        summed over the objects of an image, as BOP defines the column ``time``.
    """
    best: dict[tuple[int, int, int], tuple[BopResult, float]] = {}
    for result, uncertainty in estimates:
        if result.target not in best or uncertainty < best[result.target][1]:
            best[result.target] = result, uncertainty
    seconds: dict[tuple[int, int], float] = defaultdict(float)
    for result, _ in best.values():
        seconds[result.target[:2]] += result.seconds
    return [replace(result, seconds=seconds[result.target[:2]]) for result, _ in best.values()]


def _numbers(values: np.ndarray) -> str:
    return " ".join(map(repr, values.ravel().tolist()))


def _id(value: str, known: Collection[int] | None, where: str, what: str) -> int:
    if not is_id(value.strip()):
        raise InputError(f"{where}: expected an integer >= 0, got {value!r:.80}")
    number = int(value)
    if known is not None and number not in known:
        some = ", ".join(map(str, sorted(known)[:8])) + (", ..." if len(known) > 8 else "")
        raise InputError(f"{where} {number} is not in the dataset, whose {what} has {some}")
    return number
