"""Options of the command ``check-data``."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ...core.validation import require_within


@dataclass(frozen=True)
class CheckDataConfig:
    """Finds common mistakes in a BOP dataset: units, axes, quaternions, cameras, masks, files.

    Reads all JSON files, and a sample of images, masks and depth maps, evenly spread over all
    scenes. Equal findings are one row. The exit code is 1 if there are errors, else 0.
    """

    data: Annotated[Path, tyro.conf.Positional]
    """The dataset: a folder in BOP's layout, or a name below $BOP_PATH."""
    split: str | None = None
    """Folder of the scenes, such as `test`; none = every folder that holds scenes."""
    scenes: int = 0
    """Maximum scenes of a split to read, evenly spread; 0 = all."""
    images: int = 1000
    """Maximum images of a split to check, evenly spread; 0 = all. An image with masks takes about
    0.1 s, longer where projections are wrong."""
    out: Path | None = None
    """Folder for overlay images of wrong projections."""
    overlays: int = 8
    """Maximum number of overlay images."""
    json: Path | None = None
    """Write the findings as a results file."""

    def __post_init__(self) -> None:
        require_within(self, 0, math.inf, "scenes", "images", "overlays")
