"""What a user hands over in files: photographs, depth maps and matrices."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.images import read_image


def read_matrix(path: Path, name: str, keys: tuple[str, ...] = ()) -> np.ndarray:
    """Reads a matrix from .json (nested lists, or an object that holds one), .txt or .npy.

    Args:
        path: the file.
        name: what to call it in errors.
        keys: the keys under which a JSON object may hold it.

    Returns:
        float64; nine or sixteen numbers in a row become 3x3 or 4x4.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it holds no matrix of numbers.
    """
    try:
        if path.suffix == ".npy":
            values: Any = np.load(path, allow_pickle=False)
        elif path.suffix == ".json":
            values = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(values, dict):
                found = [key for key in keys if key in values]
                if not found:
                    raise InputError(f"has none of the keys {', '.join(keys)}")
                values = values[found[0]]
        else:
            values = np.loadtxt(path, delimiter="," if "," in path.read_text() else None)
        matrix = np.asarray(values, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise InputError(f"{name}: {path} holds no matrix of numbers ({error})") from error
    if matrix.size in (9, 16) and matrix.ndim == 1:
        matrix = matrix.reshape(round(matrix.size**0.5), -1)
    return matrix


_NEAREST, _FARTHEST = 0.05, 30.0
"""Meters between which the median of a depth map is to be: else its unit is wrong."""


def read_depth_map(path: Path, unit: float | None = None) -> np.ndarray:
    """Reads a depth map in meters, float32 (H, W), 0 where nothing was seen.

    Args:
        path: a 16-bit gray PNG or TIFF, or a .npy.
        unit: meters that a step of the file means; none = millimeters for whole numbers and meters
            for others.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it holds no map, or the unit cannot be right.
    """
    if unit is not None and not 0 < unit < float("inf"):
        raise InputError(f"depth_unit must be positive meters a step, got {unit}")
    try:
        npy = path.suffix == ".npy"
        steps = np.load(path, allow_pickle=False) if npy else read_image(path, None)
    except (EOFError, ValueError) as error:
        raise InputError(f"depth {path} is neither a picture file nor a .npy array") from error
    if steps.ndim != 2 or steps.dtype.kind not in "uif" or steps.dtype == np.uint8:
        raise InputError(
            f"depth {path} must be one channel of 16 bits or more (or a .npy of numbers), got "
            f"{steps.dtype} of shape {steps.shape}"
        )
    if unit is None:
        unit = 1.0 if steps.dtype.kind == "f" else 0.001
    depth = (steps.astype(np.float64) * unit).astype(np.float32)
    seen = depth[np.isfinite(depth) & (depth > 0)]
    if seen.size and not _NEAREST < float(np.median(seen)) < _FARTHEST:
        raise InputError(
            f"depth {path} has a median of {np.median(seen):.4g} m, which cannot be: "
            f"what is a step of it? depth_unit is {unit:g} m"
        )
    return depth
