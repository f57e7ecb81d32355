"""Options of the command ``check-data``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ...core.errors import InputError


@dataclass(frozen=True)
class CheckDataConfig:
    """Finds the usual mistakes in a BOP dataset: units, axes, quaternions, cameras, masks, files.

    All JSON files are read. Images, masks and depth maps are looked at in a sample, evenly spread
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
    """Most images of a split to look at, evenly spread; 0 = all. With its masks an image takes
    about a tenth of a second, and longer where projections are wrong."""
    out: Path | None = None
    """Folder for overlay images of wrong projections."""
    overlays: int = 8
    """Most overlay images to draw."""
    json: Path | None = None
    """Write the findings as a results file."""

    def __post_init__(self) -> None:
        for name in ("scenes", "images", "overlays"):
            if getattr(self, name) < 0:
                raise InputError(f"{name} must be at least 0, got {getattr(self, name)}")
