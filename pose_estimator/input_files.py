"""Reads matrices and depth maps from a user's files."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.errors import InputError
from ..core.geometry import check_depth
from ..core.images import read_image
from ..core.text_files import read_text


def read_matrix(path: Path, name: str, keys: tuple[str, ...] = ()) -> np.ndarray:
    """Reads a matrix from .json (nested lists, or an object that holds one), .txt or .npy.

    Args:
        path: the file.
        name: of the argument, for errors.
        keys: of a JSON object, the first that is there is read.

    Returns:
        float64; a list of 9 or 16 numbers is reshaped to 3x3 or 4x4.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it does not hold a matrix of numbers.
    """
    try:
        if path.suffix.lower() == ".npy":
            values: Any = np.load(path, allow_pickle=False)
        elif path.suffix.lower() == ".json":
            values = json.loads(read_text(path))
            if isinstance(values, dict):
                found = [key for key in keys if key in values]
                if not found:
                    raise InputError(f"has none of the keys {', '.join(keys)}")
                values = values[found[0]]
        else:
            text = read_text(path)
            values = np.loadtxt(text.splitlines(), delimiter="," if "," in text else None)
        matrix = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise InputError(f"{name}: {path} holds no matrix of numbers ({error})") from error
    if matrix.size in (9, 16) and matrix.ndim == 1:
        matrix = matrix.reshape(round(matrix.size**0.5), -1)
    return matrix


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
        steps = np.load(path, allow_pickle=False) if npy else read_image(path, None)
    except (EOFError, ValueError) as error:
        raise InputError(f"depth {path} is neither an image file nor a .npy array") from error
    if steps.ndim != 2 or steps.dtype.kind not in "uif" or steps.dtype == np.uint8:
        raise InputError(
            f"depth {path} must be one channel of 16 bits or more (or a .npy of numbers), got "
            f"{steps.dtype} of shape {steps.shape}"
        )
    if unit is None:
        unit = 1.0 if steps.dtype.kind == "f" else 0.001
    depth = check_depth(steps.astype(np.float64) * unit, steps.shape)
    known = depth[depth > 0]
    if not known.size:
        raise InputError(f"depth {path} has no known pixel: all are 0, NaN or infinite")
    if not _MIN_MEDIAN < float(np.median(known)) < _MAX_MEDIAN:
        raise InputError(
            f"depth {path} has an implausible median of {np.median(known):.4g} m; depth_unit is "
            f"{unit:g} m: is it right?"
        )
    return DepthMap(depth, unit)
