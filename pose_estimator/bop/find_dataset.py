"""Locates a dataset: a folder, or a name in the folder $BOP_PATH."""

import os
from pathlib import Path

from ...core.errors import InputError

BOP_PATH = "BOP_PATH"
"""The environment variable that bop_toolkit reads: the folder of all BOP datasets."""


def find_dataset(data: str | Path) -> Path:
    """Returns the folder of a dataset.

    Args:
        data: a folder, or the name of a folder in $BOP_PATH such as ``lmo``.

    Raises:
        InputError: if neither is a folder.
    """
    path = Path(data)
    if path.is_dir():
        return path
    if path.exists():
        raise InputError(f"{path} is a file; a dataset is a folder with models and scenes")
    home = os.environ.get(BOP_PATH)
    if not home:
        raise InputError(
            f"there is no dataset {path}: give its folder, or set {BOP_PATH} to the folder that "
            "holds your BOP datasets and give a name such as lmo"
        )
    named = Path(home) / path
    if path.is_absolute() or not named.is_dir():
        raise InputError(f"there is no dataset {path}, nor a folder {named} ({BOP_PATH})")
    return named
