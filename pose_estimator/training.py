"""``train-estimator``: from a folder of rendered pictures to weights that can be loaded."""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .networks import PoseNetworks


@dataclass(frozen=True)
class TrainEstimatorConfig:
    """Trains the networks of the estimators on a BOP dataset that `generate` made.

    Three stages follow each other: detector, 2D features, volume (of `mid`). Two more build on the
    2D features and need a dataset that was generated with --depth: cascade (of `early`) and points
    (of `rgbd`); with --init they are added to finished weights. Each stage writes checkpoints into
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
    """Which stages to run: detector, features, volume, cascade, points. They run in this order."""
    detector_steps: int = 1200
    """Batches of 16 frames."""
    feature_steps: int = 10000
    """Batches of 32 crops."""
    volume_steps: int = 3000
    """Batches of 12 pairs of crops; of 2 with `--preset paper`."""
    cascade_steps: int = 4000
    """Batches of 8 pairs of crops with depth."""
    points_steps: int = 4000
    """Batches of 32 crops with depth."""
    frozen_stages: int = 2
    """How many stages of the pretrained encoders stay as they are: fewer learn more, more are
    quicker. It may change when a run is resumed."""
    learning_rate: float = 1.0
    """Multiplies every stage's learning rate."""
    preset: str = "fast"
    """Volumes of the Mid-Fusion: `fast` or `paper`, which has the paper's grids, layers and losses.
    `--preset paper --stages volume --init linemod` trains such a volume alone, on finished 2D
    features: about two seconds a step on two cores, two to three hours for 4000."""
    pose_noise: tuple[float, float] = (0.0, 0.0)
    """Largest error of the relative camera pose that the volume is told in training: degrees and
    millimetres."""
    pose_loss: float = 1.0
    """Weight of the pose loss in the volume's training; 0 trains without it."""
    cut_and_paste: float = 0.0
    """Probability that another object is pasted over a crop, and that its background is replaced by
    a piece of another picture."""
    init: str | None = None
    """Weights to start from instead of ImageNet: the name of shipped ones, or a .safetensors file.
    What is not trained anew is kept. Of other objects' weights, or those of another preset, the
    parts are taken over that fit, and what these are is printed."""
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

    def __post_init__(self) -> None:
        for name, values in (("pose_noise", self.pose_noise), ("pose_loss", (self.pose_loss,))):
            if not all(0 <= value < math.inf for value in values):
                raise ValueError(f"{name} must be finite and at least 0, got {getattr(self, name)}")
        if not 0 <= self.cut_and_paste <= 1:
            raise ValueError(f"cut_and_paste must be 0 to 1, got {self.cut_and_paste}")


_STAGES = {
    "detector": {"batch": 16, "learning_rate": 1e-3},
    "features": {"batch": 32, "learning_rate": 1e-3},
    "volume": {"batch": 12, "learning_rate": 2e-3},
    "cascade": {"batch": 8, "learning_rate": 2e-3},
    "points": {"batch": 32, "learning_rate": 2e-3},
}

_PAPER_VOLUME = {"batch": 2, "learning_rate": 1e-3}
"""Of the stage volume with the preset ``paper``, whose volumes have a hundred times the voxels."""


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
    from .cut_and_paste import CutAndPasteConfig
    from .dataset import TrainingSet
    from .depth_stage import CascadeStage
    from .networks import PARTS, NetworkConfig, PoseNetworks
    from .point_stage import PointStage
    from .results import write_results
    from .stages import DetectorStage, FeatureStage
    from .trainer import LoopConfig, keep_freed_memory, restore_model, run_stage
    from .volume_stage import VolumeStage
    from .weights import find_weights, read_header, save_weights

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
        start_from(config, networks)
    elif config.pretrained:
        networks.detector.encoder.load_pretrained()
        networks.features.encoder.load_pretrained()
    if config.pretrained or config.init is not None:
        networks.detector.encoder.freeze(config.frozen_stages)
        networks.features.encoder.freeze(config.frozen_stages)

    pack = pack_dataset(config.data, objects, split=config.split)
    paste = CutAndPasteConfig(occlude=config.cut_and_paste, background=config.cut_and_paste)
    train, held_out = (
        TrainingSet(
            pack, objects, networks.config.features, validation=config.validation, held_out=later,
            cut_and_paste=paste if config.cut_and_paste and not later else None,
        )
        for later in (False, True)
    )  # fmt: skip
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
    classes: dict[
        str, type[DetectorStage | FeatureStage | VolumeStage | CascadeStage | PointStage]
    ] = {
        "detector": DetectorStage,
        "features": FeatureStage,
        "volume": VolumeStage,
        "cascade": CascadeStage,
        "points": PointStage,
    }
    steps = {
        "detector": config.detector_steps,
        "features": config.feature_steps,
        "volume": config.volume_steps,
        "cascade": config.cascade_steps,
        "points": config.points_steps,
    }
    stage_settings = _STAGES | ({"volume": _PAPER_VOLUME} if config.preset == "paper" else {})
    degrees, millimetres = config.pose_noise
    extra: dict[str, dict[str, Any]] = {
        "volume": {"pose_noise": (degrees, millimetres / 1000), "pose_weight": config.pose_loss}
    }
    done: list[str] = []
    for name, stage_class in classes.items():
        settings = stage_settings[name]
        if name in config.stages:
            stage = stage_class(
                networks, train, held_out, steps=steps[name], batch=int(settings["batch"]),
                learning_rate=settings["learning_rate"] * config.learning_rate, seed=config.seed,
                **extra.get(name, {}),
            )  # fmt: skip
            run_stage(stage, loop, log)
        elif (config.out / f"{name}.safetensors").is_file():
            # A stage that is not asked for keeps what an earlier run left.
            restore_model(classes[name](
                networks, train, held_out, steps=1, batch=1, learning_rate=1.0, seed=0
            ).module, config.out / f"{name}.safetensors")  # fmt: skip
        else:
            continue
        # Parts that were trained on other features are of no use with these; the volume's training
        # changes the map that the points read.
        if name == "features":
            networks.trained -= {"volume", "cascade", "points"}
        elif name == "volume":
            networks.trained -= {"points"}
        networks.trained |= {name}
        done.append(name)
    path = config.out / "weights.safetensors"
    header: dict[str, Any] = {
        "what": ", ".join(part for part in PARTS if part in networks.trained),
        "trained_on": _describe_data(config.data),
        "training": {
            "steps": {name: steps[name] for name in done},
            "batch": {name: stage_settings[name]["batch"] for name in done},
            "seed": config.seed,
            "cut_and_paste": config.cut_and_paste,
            "encoder": "EfficientNet-Lite0, ImageNet (Apache-2.0)" if config.pretrained else "none",
        },
        "held_out": figures,
    }
    if "volume" in config.stages:
        header["training"] |= {
            "pose_noise": {"degrees": degrees, "millimetres": millimetres},
            "pose_loss": config.pose_loss,
        }
    if config.init is not None:
        first = read_header(find_weights(config.init))
        header["started_from"] = {n: first.get(n) for n in ("what", "trained_on", "training")}
    save_weights(networks, path, header)
    if config.json is not None:
        records = [
            {"metric": name.split("/")[1], "value": value, "unit": "", "stage": name.split("/")[0]}
            for name, value in figures.items()
        ]
        write_results(config.json, records, command="train-estimator", seed=config.seed)
    print(f"weights: {path}")
    method = {"cascade": "early", "points": "rgbd"}.get(done[-1] if done else "", "mid")
    print(f"evaluate them: python -m two_view_pose evaluate --method {method} --weights {path}")
    return path


def start_from(config: TrainEstimatorConfig, networks: PoseNetworks) -> None:
    """Fills networks with what the weights ``config.init`` know, and prints what that is.

    Raises:
        FileNotFoundError: if there are no such weights.
        ValueError: if they are damaged, or know other objects and the stages that would learn the
            new ones are not asked for.
    """
    from .transfer import take_over
    from .weights import find_weights, read_networks

    assert config.init is not None
    other = read_networks(find_weights(config.init))
    transfer = take_over(other, networks)
    print(f"weights {config.init}\n{transfer}")
    missing = [
        part
        for part in ("detector", "features")
        if part in transfer.incomplete
        and part not in config.stages
        and not (config.out / f"{part}.safetensors").is_file()
    ]
    if missing:
        raise ValueError(
            f"the weights {config.init} know {', '.join(other.objects)}, and the training asks for "
            f"{', '.join(networks.objects)}: add {' and '.join(missing)} to --stages, which must "
            f"learn {', '.join(transfer.new)}"
        )


def _describe_data(data: Path) -> Any:
    """What the dataset says of itself."""
    manifest = Path(data) / "manifest.json"
    if not manifest.is_file():
        return {"dataset": Path(data).name}
    content = json.loads(manifest.read_text())
    generated = {name: content[name] for name in ("settings", "scenes") if name in content}
    return {"dataset": Path(data).name, "generate": generated}
