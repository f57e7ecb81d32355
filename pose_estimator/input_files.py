"""Reads matrices and depth maps from a user's files."""

import errno
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.array_files import load_arrays
from ..core.errors import InputError
from ..core.geometry import check_depth
from ..core.images import read_image
from ..core.text_files import read_text


def read_content(path: Path, name: str) -> Any:
    """Reads numbers from .json, .npy, .npz, OpenCV's or ROS' .yml, .yaml and .xml, or text.

    Args:
        path: the file.
        name: of the argument, for errors.

    Returns:
        An array or nested lists, or a dictionary that holds some.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it does not hold numbers.
    """
    suffix = path.suffix.lower()
    try:
        if suffix in (".npy", ".npz"):
            return load_arrays(path)
        if suffix == ".json":
            return json.loads(read_text(path))
        if suffix in (".yml", ".yaml", ".xml"):
            return _read_storage(path)
        text = read_text(path)
        return np.loadtxt(text.splitlines(), delimiter="," if "," in text else None)
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError(f"{name}: {path} holds no matrix of numbers ({error})") from error


def read_matrix(
    path: Path, name: str, keys: tuple[str, ...] = (), content: Any = None
) -> np.ndarray:
    """Reads a matrix from a file of numbers; see `read_content`.

    Args:
        path: the file.
        name: of the argument, for errors.
        keys: of a dictionary, the first that is there is read.
        content: of the file where it was read before.

    Returns:
        float64; a list of 9, 12 or 16 numbers is reshaped to 3x3, 3x4 or 4x4.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it does not hold a matrix of numbers.
    """
    values = read_content(path, name) if content is None else content
    try:
        if isinstance(values, dict):
            found = [key for key in keys if key in values]
            if not found:
                raise InputError(f"has none of the keys {', '.join(keys)}")
            values = values[found[0]]
            if isinstance(values, dict) and "data" in values:
                values = values["data"]
        if np.iscomplexobj(values):
            raise InputError("they are complex")
        matrix = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{name}: {path} holds no matrix of numbers ({error})") from error
    shapes = {9: (3, 3), 12: (3, 4), 16: (4, 4)}
    return matrix.reshape(shapes[matrix.size]) if _is_list(matrix, shapes) else matrix


def _is_list(matrix: np.ndarray, shapes: Mapping[int, tuple[int, int]]) -> bool:
    return matrix.size in shapes and matrix.size in matrix.shape


def _read_storage(path: Path) -> dict[str, Any]:
    """Returns the numbers and matrices of OpenCV's FileStorage, which reads ROS' files too."""
    import cv2  # not for --help

    if not path.is_file():
        raise FileNotFoundError(errno.ENOENT, "No such file", str(path))
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        root = storage.root()
        found: dict[str, Any] = {}
        for key in root.keys():  # noqa: SIM118
            node = storage.getNode(key)
            data = node.getNode("data") if node.isMap() else node
            if data.isSeq():
                found[key] = [_number(data.at(i)) for i in range(data.size())]
            elif node.isReal() or node.isInt():
                found[key] = node.real()
        return found
    except (cv2.error, SystemError) as error:
        raise ValueError("it is not of cv2.FileStorage") from error


def _number(node: Any) -> Any:
    return [node.at(i).real() for i in range(node.size())] if node.isSeq() else node.real()


_MIN_MEDIAN, _MAX_MEDIAN = 0.05, 30.0
"""Meters: a depth map with another median has the wrong unit."""


class DepthMap(NamedTuple):
    """A depth map that was read from a file.

    Attributes:
        meters: along z, float32 (H, W); 0 = unknown.
        unit: meters per unit of the file.
    """

    meters: np.ndarray
    unit: float


def read_depth_map(path: Path, unit: float | None = None) -> DepthMap:
    """Reads a depth map; what is 0, NaN or infinite is unknown.

    Args:
        path: a 16-bit gray PNG or TIFF, or a .npy.
        unit: meters per unit of the file; None: 0.001 for integers, 1 for floats.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it does not hold a depth map, all of it is unknown, or the unit is
            implausible.
    """
    if unit is not None and not 0 < unit < float("inf"):
        raise InputError(f"depth_unit must be positive, in meters, got {unit}")
    try:
        npy = path.suffix.lower() == ".npy"
        steps = load_arrays(path) if npy else read_image(path, None)
    except ValueError as error:
        raise InputError(f"depth {path} is neither an image file nor a .npy array") from error
    if steps.ndim != 2 or steps.dtype.kind not in "uif" or steps.dtype == np.uint8:
        raise InputError(
            f"depth {path} must be one channel of 16 bits or more (or a .npy of numbers), got "
            f"{steps.dtype} of shape {steps.shape}"
        )
    if unit is None:
        unit = 1.0 if steps.dtype.kind == "f" else 0.001
    depth = check_depth(steps.astype(np.float64) * unit, steps.shape, f"depth {path}")
    known = depth[depth > 0]
    if not known.size:
        raise InputError(f"depth {path} has no known pixel: all are 0, NaN or infinite")
    if not _MIN_MEDIAN < float(np.median(known)) < _MAX_MEDIAN:
        raise InputError(
            f"depth {path} has an implausible median of {np.median(known):.4g} m; depth_unit is "
            f"{unit:g} m: is it right?"
        )
    return DepthMap(depth, unit)
