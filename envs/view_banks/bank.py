"""View banks: offline datasets with the outcome of every candidate view of many scenes.

A policy is trained and evaluated on a bank at thousands of steps a second; the live environment
takes a fifth of a second for each. A bank is one compressed file with a checksum.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from ...core.array_files import load_arrays
from ...core.errors import InputError
from ...core.files import write_atomically
from ...core.results import commit, versions
from ...core.validation import is_number
from ...pose_estimator.types import PoseEstimate
from ..observation import Observation

FORMAT = "two-view-pose view bank 1"

FIRST_FIELDS = ("rotation", "translation", "uncertainty", "score", "object", "camera", "image")
SECOND_FIELDS = ("rotation", "translation", "uncertainty", "score", "camera")
"""Fields of an observation that depend on the second view."""


@dataclass(frozen=True)
class BankHeader:
    """Metadata of a bank.

    Attributes:
        source: "simulation", or the name of the dataset of photographs.
        scene: kind of the scenes, or the dataset's split.
        object_names: in the order of the observation's one-hot.
        diameters: of these objects, meters.
        candidate_views: (azimuth offset, elevation) of each slot (index of a candidate), degrees.
        estimator: that was recorded.
        seed: of the scenes.
        settings: other settings of the recording.
        versions: of the packages when the bank was written.
        commit: of the checkout, None for an installed wheel.
        digest: SHA-256 of all arrays; set by :func:`write_bank`.
        format: name and version of the file format.
    """

    source: str
    scene: str
    object_names: tuple[str, ...]
    diameters: tuple[float, ...]
    candidate_views: tuple[tuple[float, float], ...]
    estimator: str
    seed: int
    settings: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=versions)
    commit: str | None = field(default_factory=commit)
    digest: str = ""
    format: str = FORMAT


@dataclass(frozen=True, eq=False)
class ViewBank:
    """M scenes by N candidate views ("slots").

    Attributes:
        header: metadata.
        first: the observation after the reference view, each field (M, ...).
        second: fields of the observation after the second view, each (M, N, ...).
        object_index: the target, (M,).
        scene_seed: seed of the scene (of a photograph: its number), (M,).
        visibility: of the target in the reference view, (M,), 0 to 1.
        T_cam_obj: estimate from the reference view, (M, 4, 4).
        keypoints: its keypoints in the reference camera, (M, 9, 3), meters.
        covariance: of the keypoints, (M, 9, 3, 3), square meters.
        K: camera matrix of the reference view, (M, 3, 3).
        T_cam_world: reference camera, (M, 4, 4).
        center: of the view sphere, (M, 3), world.
        first_error: ADD(-S) over the diameter from the reference view alone, (M,).
        second_T_cam_world: camera of each slot, (M, N, 4, 4).
        second_T_cam_obj: the estimate from both views, (M, N, 4, 4), in the reference camera.
        second_error: its ADD(-S) over the diameter, (M, N); NaN without an estimate.
        second_visibility: true visible fraction of the target, (M, N); NaN where unknown.
        travel: of the camera to each slot, (M, N), meters.
    """

    header: BankHeader
    first: dict[str, np.ndarray]
    second: dict[str, np.ndarray]
    object_index: np.ndarray
    scene_seed: np.ndarray
    visibility: np.ndarray
    T_cam_obj: np.ndarray
    keypoints: np.ndarray
    covariance: np.ndarray
    K: np.ndarray
    T_cam_world: np.ndarray
    center: np.ndarray
    first_error: np.ndarray
    second_T_cam_world: np.ndarray
    second_T_cam_obj: np.ndarray
    second_error: np.ndarray
    second_visibility: np.ndarray
    travel: np.ndarray

    def __len__(self) -> int:
        """Number of scenes."""
        return len(self.object_index)

    @property
    def has_estimates(self) -> bool:
        """Whether poses were estimated from the second views."""
        return bool(np.isfinite(self.second_error).all())

    @property
    def slots(self) -> int:
        """Number of candidate views of each scene."""
        return self.second_error.shape[1]

    def subset(self, scenes: slice | np.ndarray) -> ViewBank:
        """Selects scenes."""
        return _from_arrays(self.header, {k: a[scenes] for k, a in self.arrays().items()})

    def arrays(self) -> dict[str, np.ndarray]:
        """All arrays by their names in the file; the first axis is the scene."""
        plain = {key: getattr(self, name) for name, key in _PLAIN.items()}
        plain |= {f"first/{key}": array for key, array in self.first.items()}
        return plain | {f"second/{key}": array for key, array in self.second.items()}


_PLAIN = {
    f.name: "centre" if f.name == "center" else f.name
    for f in fields(ViewBank)
    if f.name not in ("header", "first", "second")
}
"""The names of the plain arrays in the file; banks that exist have a British one."""


def concatenate(header: BankHeader, parts: Sequence[Mapping[str, np.ndarray]]) -> ViewBank:
    """Concatenates arrays of scenes to one bank."""
    return _from_arrays(header, {k: np.concatenate([p[k] for p in parts]) for k in parts[0]})


def scene_arrays(
    first: Observation,
    estimate: PoseEstimate,
    seconds: Sequence[tuple[Observation, np.ndarray, np.ndarray, float]],
) -> dict[str, np.ndarray]:
    """Returns the arrays of one scene (see :class:`ViewBank`) that do not need ground truth.

    Args:
        first: observation after the reference view.
        estimate: from the reference view.
        seconds: for each slot the observation, camera (4, 4), estimate (4, 4) and travel (m).
    """
    observations, cameras, estimates, travel = zip(*seconds, strict=True)
    arrays = {f"first/{key}": first[key][None] for key in FIRST_FIELDS}
    for key in SECOND_FIELDS:
        arrays[f"second/{key}"] = np.stack([o[key] for o in observations])[None]
    return arrays | {
        "T_cam_obj": estimate.T_cam_obj[None],
        "keypoints": estimate.keypoints[None].astype(np.float32),
        "covariance": estimate.keypoint_covariance[None].astype(np.float32),
        "second_T_cam_world": np.stack(cameras)[None],
        "second_T_cam_obj": np.stack(estimates)[None],
        "travel": np.array([travel], np.float32),
    }


def write_bank(path: str | os.PathLike[str], bank: ViewBank) -> None:
    """Writes a bank atomically."""
    arrays = bank.arrays()
    header = asdict(bank.header) | {"digest": _digest(arrays)}
    text = json.dumps(header, sort_keys=True, allow_nan=False).encode()
    write_arrays(path, {"header": np.frombuffer(text, np.uint8), **arrays})


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Writes arrays, such as those of one scene, atomically."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    write_atomically(path, stream.getvalue())


def read_arrays(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Reads a file of :func:`write_arrays`.

    Raises:
        OSError: if it cannot be opened.
        InputError: if it is not such a file, or damaged.
    """
    try:
        arrays = load_arrays(path)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    if not isinstance(arrays, dict):
        raise InputError(f"{path} holds one array, not several by name")
    return arrays


def read_bank(path: str | os.PathLike[str]) -> ViewBank:
    """Reads a bank and verifies its checksum.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it is not a view bank file, or corrupted.
    """
    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(
            f"view bank {source} does not exist; `python -m two_view_pose record-bank --out "
            f"{source}` records one"
        )
    try:
        arrays = read_arrays(source)
        content = json.loads(bytes(arrays.pop("header")))
    except (KeyError, RecursionError, TypeError, ValueError) as error:
        raise InputError(f"{source} is not a valid view bank: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else content
        raise InputError(f"view bank {source} must have the format {FORMAT!r}, got {found!r:.80}")
    try:
        header = BankHeader(**{k: _tuples(v) for k, v in content.items()})
        bank = _from_arrays(header, arrays)
        _check_header(bank)
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"view bank {source} is corrupted: {error}") from error
    if _digest(arrays) != header.digest:
        raise InputError(f"view bank {source} is corrupted: its checksum does not match")
    return bank


def _check_header(bank: ViewBank) -> None:
    """Raises TypeError or ValueError where the header, which has no checksum, is not valid."""
    header = bank.header
    kinds: dict[str, type] = {"settings": dict, "seed": int}
    kinds |= dict.fromkeys(("source", "scene", "estimator", "digest"), str)
    kinds |= dict.fromkeys(("object_names", "diameters", "candidate_views"), tuple)
    for name, kind in kinds.items():
        value = getattr(header, name)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise TypeError(f"{name} is {value!r:.80}")
    if not all(isinstance(name, str) for name in header.object_names):
        raise TypeError(f"object_names are {header.object_names!r:.80}")
    numbers = [*header.diameters, *(angle for view in header.candidate_views for angle in view)]
    if not all(is_number(number) and abs(number) < 1e6 for number in numbers):
        raise TypeError("diameters or candidate_views are not numbers")
    objects, slots = len(header.object_names), np.shape(header.candidate_views)
    if len(header.diameters) != objects or not all(d > 0 for d in header.diameters):
        raise ValueError(f"diameters of {objects} objects are {header.diameters!r:.80}")
    if slots != (bank.slots, 2):
        raise ValueError(f"candidate_views of {bank.slots} slots are of shape {slots}")
    if len(bank) and not 0 <= bank.object_index.min() <= bank.object_index.max() < objects:
        raise ValueError(f"object_index is not below {objects}")


def _from_arrays(header: BankHeader, arrays: Mapping[str, np.ndarray]) -> ViewBank:
    return ViewBank(
        header=header,
        first={key: arrays[f"first/{key}"] for key in FIRST_FIELDS},
        second={key: arrays[f"second/{key}"] for key in SECOND_FIELDS},
        **{name: arrays[key] for name, key in _PLAIN.items()},
    )


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of names, dtypes, shapes and contents."""
    sha = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        sha.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()


def _tuples(value: Any) -> Any:
    """Converts JSON's lists back to tuples."""
    if isinstance(value, dict):
        return {key: _tuples(part) for key, part in value.items()}
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value
