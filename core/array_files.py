"""Reads NumPy's files of arrays."""

import os
from typing import Any

import numpy as np


def load_arrays(path: str | os.PathLike[str]) -> Any:
    """Returns the array of a .npy file, or the dictionary of arrays of a .npz file.

    Raises:
        OSError: if it cannot be opened.
        ValueError: if it is truncated, damaged or another file.
    """
    with open(path, "rb") as stream:
        try:
            values = np.load(stream, allow_pickle=False)
            return values if isinstance(values, np.ndarray) else dict(values)
        except MemoryError:
            raise
        except Exception as error:  # NumPy and zipfile raise all kinds of errors
            raise ValueError(f"it is truncated or damaged: {error}") from error
