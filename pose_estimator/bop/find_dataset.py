"""Where a dataset is: a folder, or a name below the folder that BOP_PATH names."""

from __future__ import annotations

import os
from pathlib import Path

from ...core.errors import InputError

BOP_PATH = "BOP_PATH"
"""The environment variable that bop_toolkit reads: the folder of all BOP datasets."""


def find_dataset(data: str | Path) -> Path:
    """The folder of a dataset.

    Args:
        data: a folder; or, where there is no such folder, a dataset's name such as ``lmo``, which
            is looked for in the folder that the environment variable BOP_PATH names.

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
