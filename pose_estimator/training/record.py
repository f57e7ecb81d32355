"""The log of a training, and the header of its weights."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import warn

from ...core.errors import InputWarning
from ...core.files import naming
from ...core.text_files import read_text
from ...core.validation import is_number
from ..bop.manifest import read_manifest
from ..methods import PARTS
from .config import TrainEstimatorConfig

if TYPE_CHECKING:
    from ..networks.container import PoseNetworks

_HELD_OUT = "held_out/"
"""How the names of validation results begin."""


class TrainingLog:
    """A log file with one JSON object per line.

    Args:
        path: the file; lines are appended.
        resume: read the validation results that the file holds.

    Attributes:
        held_out: the latest validation results, as ``stage/metric``.
    """

    def __init__(self, path: Path, *, resume: bool = False):
        self._path = path
        self._half_line = False
        self.held_out: dict[str, float] = {}
        if resume and path.is_file():
            self._read(read_text(path))

    def _read(self, text: str) -> None:
        """Reads entries; killed runs leave halves of lines, which are ignored."""
        self._half_line = bool(text) and not text.endswith("\n")
        ignored = []
        for number, line in enumerate(text.split("\n"), start=1):
            try:
                entry: dict[str, Any] = json.loads(line) if line else {"stage": ""}
                stage = entry.pop("stage")
                measured = {n: v for n, v in entry.items() if n.startswith(_HELD_OUT)}
                if not isinstance(stage, str) or not all(map(is_number, measured.values())):
                    raise TypeError("no stage, or no number")
                self._remember(stage, measured)
            except (AttributeError, KeyError, RecursionError, TypeError, ValueError):
                ignored.append(number)
        if ignored:
            warn(
                f"{self._path}: line {ignored[0]} is not an entry, as after a killed run; "
                f"{len(ignored)} ignored",
                InputWarning,
                stacklevel=3,
            )

    def __call__(self, stage: str, step: int, values: Mapping[str, float]) -> None:
        """Appends a line; values are named ``train/...`` or ``held_out/...``."""
        entry = {"stage": stage, "step": step, "time": round(time.time(), 1), **values}
        start = "\n" if self._half_line else ""
        with naming(self._path), open(self._path, "a") as file:
            file.write(start + json.dumps(entry) + "\n")
        self._half_line = False
        self._remember(stage, values)

    def _remember(self, stage: str, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            if name.startswith(_HELD_OUT):
                self.held_out[f"{stage}/{name.removeprefix(_HELD_OUT)}"] = value

    def write_results(self, config: TrainEstimatorConfig) -> None:
        """Writes the validation results as a results file."""
        from ...core.results import write_results

        assert config.json is not None
        records = [
            {"metric": name.split("/")[1], "value": value, "unit": "", "stage": name.split("/")[0]}
            for name, value in self.held_out.items()
        ]
        write_results(config.json, records, command="train-estimator", seed=config.seed)


def header(
    config: TrainEstimatorConfig,
    networks: PoseNetworks,
    done: Mapping[str, int],
    held_out: Mapping[str, float],
) -> dict[str, Any]:
    """Returns the header of the weights, given the step that each stage has reached."""
    from ..networks.weights import find_weights, read_header
    from .distributed import world_size

    stages = {name: config.stage(name, len(networks.objects)) for name in done}
    content: dict[str, Any] = {
        "what": ", ".join(part for part in PARTS if part in networks.trained),
        "trained_on": describe_data(config.data),
        "training": {
            "steps": dict(done),
            "batch": {name: world_size() * settings.batch for name, settings in stages.items()},
            "seed": config.seed,
            "cut_and_paste": config.cut_and_paste,
            "augmentation": config.augmentation,
            "tune_encoder": config.tune_encoder,
            "frozen_stages": config.frozen_stages,
            "cycles": config.lr_cycles,
            "encoder": "EfficientNet-Lite0, ImageNet (Apache-2.0)" if config.pretrained else "none",
        },
        "held_out": dict(held_out),
    }
    if config.attribution:
        content["attribution"] = config.attribution
    if "volume" in config.stages:
        degrees, millimeters = config.pose_noise
        content["training"] |= {
            "pose_noise": {"degrees": degrees, "millimeters": millimeters},
            "pose_loss": config.pose_loss,
            "tune_features": config.tune_features,
        }
    if config.init is not None:
        first = read_header(find_weights(config.init))
        content["started_from"] = {n: first.get(n) for n in ("what", "trained_on", "training")}
    return content


def describe_data(data: Path) -> Any:
    """Returns the dataset's name, and how it was generated where it has a manifest."""
    content = read_manifest(data)
    if content is None:
        return {"dataset": Path(data).name}
    generated = {name: content[name] for name in ("settings", "scenes") if name in content}
    return {"dataset": Path(data).name, "generate": generated}
