"""``train-estimator``: from a folder of rendered pictures to weights that can be loaded."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class TrainEstimatorConfig:
    """Trains the networks of `single` and `mid` on a BOP dataset that `generate` made.

    Three stages follow each other: detector, 2D features, volume. Each writes checkpoints into
    --out; the same command continues where a killed run stopped. On two cores the default takes
    about two hours.
    """

    data: Path
    """BOP dataset, as `generate` writes it."""
    out: Path
    """Folder for checkpoints, log and the finished weights (OUT/weights.safetensors)."""
    objects: tuple[str, ...] = ()
    """Objects to train, by name or path of a mesh; none = the 13 of LineMOD."""
    split: str = "train_pbr"
    """Folder of the dataset that holds the scenes."""
    stages: tuple[str, ...] = ("detector", "features", "volume")
    """Which stages to run, in this order."""
    detector_steps: int = 1200
    """Batches of 16 frames."""
    feature_steps: int = 10000
    """Batches of 32 crops."""
    volume_steps: int = 3000
    """Batches of 12 pairs of crops."""
    frozen_stages: int = 2
    """How many stages of the pretrained encoders stay as they are: fewer learn more, more are
    quicker. It may change when a run is resumed."""
    learning_rate: float = 1.0
    """Multiplies every stage's learning rate."""
    preset: str = "fast"
    """Volumes of the Mid-Fusion: `fast` or `paper`."""
    init: Path | None = None
    """Weights (.safetensors) to start from instead of ImageNet; they must know the same objects."""
    pretrained: bool = True
    """Start the encoders from ImageNet (needs the extra `train`)."""
    validation: float = 0.03
    """Fraction of the scenes that is held out."""
    seed: int = 0
    """Of everything random."""
    threads: int = 0
    """Threads for the networks; 0 = as many as there are cores."""
    checkpoint_every: float = 120.0
    """Seconds between checkpoints."""
    resume: bool = True
    """Continue from the checkpoints in --out; --no-resume starts anew."""
    json: Path | None = None
    """Write the held-out figures as a results file."""


_STAGES = {
    "detector": {"batch": 16, "learning_rate": 1e-3},
    "features": {"batch": 32, "learning_rate": 1e-3},
    "volume": {"batch": 12, "learning_rate": 2e-3},
}


def train_estimator(config: TrainEstimatorConfig) -> Path:
    """Trains and saves weights.

    Returns:
        The weights file.

    Raises:
        ValueError: if the configuration or the data is wrong.
        FileNotFoundError: if the dataset is missing.
    """
    import torch

    from .. import assets
    from .crops import pack_dataset
    from .dataset import TrainingSet
    from .networks import NetworkConfig, PoseNetworks
    from .results import write_results
    from .stages import DetectorStage, FeatureStage, VolumeStage
    from .trainer import LoopConfig, keep_freed_memory, restore_model, run_stage
    from .weights import read_networks, save_weights

    unknown = [stage for stage in config.stages if stage not in _STAGES]
    if unknown:
        raise ValueError(f"unknown stages {unknown}; there are {', '.join(_STAGES)}")
    if config.threads:
        torch.set_num_threads(config.threads)
    keep_freed_memory()
    torch.manual_seed(config.seed)
    objects = assets.load_objects(list(config.objects) or None)
    networks = PoseNetworks(objects, NetworkConfig(preset=config.preset))
    if config.init is not None:
        networks.load_state_dict(read_networks(config.init).state_dict())
    elif config.pretrained:
        networks.detector.encoder.load_pretrained()
        networks.features.encoder.load_pretrained()
    if config.pretrained or config.init is not None:
        networks.detector.encoder.freeze(config.frozen_stages)
        networks.features.encoder.freeze(config.frozen_stages)

    pack = pack_dataset(config.data, objects, split=config.split)
    train, held_out = (
        TrainingSet(
            pack, objects, networks.config.features, validation=config.validation, held_out=later
        )
        for later in (False, True)
    )
    config.out.mkdir(parents=True, exist_ok=True)
    figures: dict[str, float] = {}
    log_path = config.out / "log.jsonl"

    def log(stage: str, step: int, numbers: dict[str, float]) -> None:
        entry = {"stage": stage, "step": step, "time": round(time.time(), 1), **numbers}
        with open(log_path, "a") as file:
            file.write(json.dumps(entry) + "\n")
        figures.update(
            {
                f"{stage}/{n.split('/')[1]}": v
                for n, v in numbers.items()
                if n.startswith("held_out")
            }
        )

    loop = LoopConfig(
        out=config.out, checkpoint_every=config.checkpoint_every, resume=config.resume
    )
    classes: dict[str, type[DetectorStage | FeatureStage | VolumeStage]] = {
        "detector": DetectorStage,
        "features": FeatureStage,
        "volume": VolumeStage,
    }
    steps = {
        "detector": config.detector_steps,
        "features": config.feature_steps,
        "volume": config.volume_steps,
    }
    for name, stage_class in classes.items():
        settings = _STAGES[name]
        if name in config.stages:
            stage = stage_class(
                networks, train, held_out, steps=steps[name], batch=int(settings["batch"]),
                learning_rate=settings["learning_rate"] * config.learning_rate, seed=config.seed,
            )  # fmt: skip
            run_stage(stage, loop, log)
        elif (config.out / f"{name}.safetensors").is_file():
            # A stage that is not asked for keeps what an earlier run left.
            restore_model(classes[name](
                networks, train, held_out, steps=1, batch=1, learning_rate=1.0, seed=0
            ).module, config.out / f"{name}.safetensors")  # fmt: skip
    path = config.out / "weights.safetensors"
    header = {
        "what": "detector, 2D features and Mid-Fusion volume",
        "trained_on": _describe_data(config.data),
        "training": {
            "steps": steps,
            "batch": {name: settings["batch"] for name, settings in _STAGES.items()},
            "seed": config.seed,
            "encoder": "EfficientNet-Lite0, ImageNet (Apache-2.0)" if config.pretrained else "none",
        },
        "held_out": figures,
    }
    save_weights(networks, path, header)
    if config.json is not None:
        records = [
            {"metric": name.split("/")[1], "value": value, "unit": "", "stage": name.split("/")[0]}
            for name, value in figures.items()
        ]
        write_results(config.json, records, command="train-estimator", seed=config.seed)
    print(f"weights: {path}")
    print(f"evaluate them: python -m two_view_pose evaluate --method mid --weights {path}")
    return path


def _describe_data(data: Path) -> Any:
    """What the dataset says of itself."""
    manifest = Path(data) / "manifest.json"
    if not manifest.is_file():
        return {"dataset": Path(data).name}
    content = json.loads(manifest.read_text())
    generated = {name: content[name] for name in ("settings", "scenes") if name in content}
    return {"dataset": Path(data).name, "generate": generated}
