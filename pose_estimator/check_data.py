"""The verb ``check-data``: what is wrong with a BOP dataset, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


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
    pictures: int = 8
    """Most overlay images to draw."""
    json: Path | None = None
    """Write the findings as a results file."""

    def __post_init__(self) -> None:
        for name in ("scenes", "images", "pictures"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must be at least 0, got {getattr(self, name)}")


def check_data(config: CheckDataConfig) -> int:
    """Checks a dataset, prints what was found, and returns the exit code.

    Raises:
        ValueError: if there is no such dataset, or an option is wrong.
    """
    from rich.console import Console

    from .data_checks import counted, find_mistakes
    from .data_pictures import draw_overlays
    from .data_report import print_findings
    from .find_dataset import find_dataset
    from .results import write_results

    root = find_dataset(config.data)
    findings, wrong, summary = find_mistakes(config, root)
    console = Console(highlight=False)
    print_findings(findings, root, console)
    errors, warnings = findings.count("error"), findings.count("warning")
    console.print(f"{root}: {summary}", soft_wrap=True)
    console.print(f"{counted(errors, 'error')}, {counted(warnings, 'warning')}")
    if config.out is not None:
        for path in draw_overlays(wrong, config.out, config.pictures):
            console.print(f"picture: {path}", soft_wrap=True)
    if config.json is not None:
        records = [
            {"metric": "errors", "value": errors, "unit": "1"},
            {"metric": "warnings", "value": warnings, "unit": "1"},
            *findings.records(),
        ]
        write_results(config.json, records, command=f"check-data {root.name}", seed=None)
    return int(errors > 0)
