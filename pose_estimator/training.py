"""``train-estimator``: from a folder of rendered pictures to weights that can be loaded."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .find_dataset import find_dataset
from .parts import PARTS, STAGES
from .training_config import TrainEstimatorConfig
from .training_objects import training_objects

if TYPE_CHECKING:
    from .dataset import TrainingSet
    from .networks import PoseNetworks
    from .stages import StageBase


def train_estimator(config: TrainEstimatorConfig) -> Path:
    """Trains and saves weights.

    Returns:
        The weights file.

    Raises:
        ValueError: if the configuration or the data is wrong, or there is no dataset.
    """
    from .data_parallel import process_group

    config = replace(config, data=find_dataset(config.data), stages=config.chosen_stages)
    with process_group():
        return _train(config)


def _train(config: TrainEstimatorConfig) -> Path:
    """Trains, in each of the processes that train together; the first writes the files."""
    import torch

    from .data_parallel import first_alone, own_threads, rank
    from .trainer import keep_freed_memory
    from .weights import save_weights

    threads = config.threads or own_threads()
    if threads:
        torch.set_num_threads(threads)
    keep_freed_memory()
    torch.manual_seed(config.seed)
    networks = start_networks(config)
    count = len(networks.objects)
    plan = [f"{n} ({config.stage(n, count).steps} steps)" for n in STAGES if n in config.stages]
    print(f"training {', '.join(networks.objects)}: {', '.join(plan)}")
    train, held_out = first_alone(lambda: open_data(config, networks))
    config.out.mkdir(parents=True, exist_ok=True)
    log = TrainingLog(config.out / "log.jsonl", resume=config.resume)
    done = [name for name in STAGES if train_stage(config, name, networks, train, held_out, log)]
    path = config.out / "weights.safetensors"
    if rank() > 0:
        return path
    content = header(config, networks, done, log.held_out)
    save_weights(networks, path, content, surfaces=config.store_meshes)
    if config.json is not None:
        log.write_results(config)
    print(f"weights: {path}")
    print(next_command(networks, done, path))
    return path


def next_command(networks: PoseNetworks, done: list[str], path: Path) -> str:
    """How to measure what was trained, or what to train before there is something to measure.

    Args:
        networks: that were trained.
        done: the stages of the training.
        path: the weights.
    """
    missing = [part for part in ("detector", "features") if part not in networks.trained]
    if missing:
        return (
            f"before they are of use they need {' and '.join(missing)}: the same command with "
            f"--stages {' '.join(missing)}"
        )
    method = {"cascade": "early", "points": "rgbd"}.get(done[-1] if done else "", "mid")
    if method == "mid" and "volume" not in networks.trained:
        method = "late"  # the best of two views that needs no more than 2D features
    return f"evaluate them: python -m two_view_pose evaluate --method {method} --weights {path}"


def start_networks(config: TrainEstimatorConfig) -> PoseNetworks:
    """Networks as the training begins with them; see :func:`start_from` for what it raises."""
    from .networks import NetworkConfig, PoseNetworks

    objects = training_objects(config.data, config.objects)
    networks = PoseNetworks(objects, NetworkConfig(preset=config.preset))
    encoders = networks.detector.encoder, networks.features.encoder
    if config.init is not None:
        start_from(config, networks)
    elif config.pretrained:
        for encoder in encoders:
            encoder.load_pretrained()
    if config.pretrained or config.init is not None:
        for encoder in encoders:
            encoder.freeze(config.frozen_stages)
    return networks


def start_from(config: TrainEstimatorConfig, networks: PoseNetworks) -> None:
    """Fills networks with what the weights ``config.init`` know, and prints what that is.

    Raises:
        FileNotFoundError: if there are no such weights.
        ValueError: if they are damaged, or lack 2D features, or know other objects, and the stages
            that would learn these are not asked for.
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
        and not any(
            stage in config.chosen_stages or (config.out / f"{stage}.safetensors").is_file()
            for stage in ((part, "decoders") if part == "features" else (part,))
        )
    ]
    if missing:
        raise ValueError(
            f"the weights {config.init} know {', '.join(other.objects)}, and the training asks for "
            f"{', '.join(networks.objects)}: add {' and '.join(missing)} to --stages, which must "
            f"learn {', '.join(transfer.new)}"
        )
    learnt = "features" in config.chosen_stages or (config.out / "features.safetensors").is_file()
    if "features" not in transfer.parts and "decoders" in config.chosen_stages and not learnt:
        raise ValueError(
            f"the weights {config.init} hold no trained 2D features for the decoders to build on: "
            "add features to --stages"
        )


def open_data(
    config: TrainEstimatorConfig, networks: PoseNetworks
) -> tuple[TrainingSet, TrainingSet]:
    """The pictures to train on and those that are held out; they are packed at the first time."""
    from .augmentation import AugmentationConfig
    from .crops import pack_dataset
    from .cut_and_paste import CutAndPasteConfig
    from .dataset import TrainingSet

    pack = pack_dataset(config.data, networks.objects, split=config.split)
    shape = networks.config.features
    chance, strong = config.cut_and_paste, config.augmentation == "strong"
    bent = AugmentationConfig.strong() if strong else AugmentationConfig()
    paste = CutAndPasteConfig(chance, chance, collages=0.5 * strong) if chance else None
    share = config.validation
    return (
        TrainingSet(pack, networks.objects, shape, bent, validation=share, cut_and_paste=paste),
        TrainingSet(pack, networks.objects, shape, bent, validation=share, held_out=True),
    )


class TrainingLog:
    """What a training says of itself, one line of JSON at a time.

    Args:
        path: the file; it is added to.
        resume: whether the figures that it holds are those of this training.

    Attributes:
        held_out: the last figures on held-out data, by stage and name.
    """

    def __init__(self, path: Path, *, resume: bool = False):
        self._path = path
        self.held_out: dict[str, float] = {}
        for line in path.read_text().splitlines() if resume and path.is_file() else ():
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                continue  # a run was killed in the middle of it
            self._remember(entry.pop("stage"), entry)

    def __call__(self, stage: str, step: int, numbers: Mapping[str, float]) -> None:
        """Adds a line; numbers are named ``train/...`` or ``held_out/...``."""
        entry = {"stage": stage, "step": step, "time": round(time.time(), 1), **numbers}
        with open(self._path, "a") as file:
            file.write(json.dumps(entry) + "\n")
        self._remember(stage, numbers)

    def _remember(self, stage: str, numbers: Mapping[str, float]) -> None:
        """Keeps what is held-out data's."""
        for name, value in numbers.items():
            kind, _, figure = name.partition("/")
            if kind == "held_out":
                self.held_out[f"{stage}/{figure}"] = value

    def write_results(self, config: TrainEstimatorConfig) -> None:
        """Writes the figures on held-out data as a results file."""
        from .results import write_results

        assert config.json is not None
        records = [
            {"metric": name.split("/")[1], "value": value, "unit": "", "stage": name.split("/")[0]}
            for name, value in self.held_out.items()
        ]
        write_results(config.json, records, command="train-estimator", seed=config.seed)


def train_stage(
    config: TrainEstimatorConfig,
    name: str,
    networks: PoseNetworks,
    train: TrainingSet,
    held_out: TrainingSet,
    log: TrainingLog,
) -> bool:
    """Trains a part of the networks if it is asked for, or restores what an earlier run made of it.

    Returns:
        Whether the part is now of this training.
    """
    from .trainer import LoopConfig, restore_model, run_stage

    checkpoint = config.out / f"{name}.safetensors"
    asked = name in config.stages
    if not asked and not checkpoint.is_file():
        return False
    settings = config.stage(name, len(networks.objects))
    extra: dict[str, Any] = {}
    if name == "volume":
        degrees, millimetres = config.pose_noise
        extra = {"pose_noise": (degrees, millimetres / 1000), "pose_weight": config.pose_loss}
    elif name == "decoders":
        extra = {"tune_encoder": config.tune_encoder}
    stage = _stage_class(name)(
        networks, train, held_out, steps=settings.steps, batch=settings.batch,
        learning_rate=settings.learning_rate, seed=config.seed, **extra,
    )  # fmt: skip
    if asked:
        loop = LoopConfig(
            out=config.out,
            checkpoint_every=config.checkpoint_every,
            resume=config.resume,
            cycles=config.cycles,
        )
        run_stage(stage, loop, log)  # type: ignore[arg-type]
    else:
        restore_model(stage.module, checkpoint)  # type: ignore[attr-defined]
    # Parts that were trained on other features are of no use with these; the cascade reads the
    # encoder alone.
    if name == "features":
        networks.trained -= {"volume", "cascade", "points"}
    elif name == "decoders":
        networks.trained -= {"volume", "points"}
    networks.trained |= {"features" if name == "decoders" else name}
    return True


def _stage_class(name: str) -> type[StageBase]:
    from .depth_stage import CascadeStage
    from .point_stage import PointStage
    from .stages import DecoderStage, DetectorStage, FeatureStage
    from .volume_stage import VolumeStage

    classes = (DetectorStage, FeatureStage, DecoderStage, VolumeStage, CascadeStage, PointStage)
    return {stage.name: stage for stage in classes}[name]


def header(
    config: TrainEstimatorConfig,
    networks: PoseNetworks,
    done: list[str],
    held_out: Mapping[str, float],
) -> dict[str, Any]:
    """What the weights say of their training.

    Args:
        config: of the training.
        networks: as they are now.
        done: the parts that are of this training.
        held_out: figures on held-out data.
    """
    from .data_parallel import world_size
    from .weights import find_weights, read_header

    stages = {name: config.stage(name, len(networks.objects)) for name in done}
    content: dict[str, Any] = {
        "what": ", ".join(part for part in PARTS if part in networks.trained),
        "trained_on": _describe_data(config.data),
        "training": {
            "steps": {name: settings.steps for name, settings in stages.items()},
            "batch": {name: world_size() * settings.batch for name, settings in stages.items()},
            "seed": config.seed,
            "cut_and_paste": config.cut_and_paste,
            "augmentation": config.augmentation,
            "tune_encoder": config.tune_encoder,
            "cycles": config.cycles,
            "encoder": "EfficientNet-Lite0, ImageNet (Apache-2.0)" if config.pretrained else "none",
        },
        "held_out": dict(held_out),
    }
    if config.attribution:
        content["attribution"] = config.attribution
    if "volume" in config.stages:
        degrees, millimetres = config.pose_noise
        content["training"] |= {
            "pose_noise": {"degrees": degrees, "millimetres": millimetres},
            "pose_loss": config.pose_loss,
        }
    if config.init is not None:
        first = read_header(find_weights(config.init))
        content["started_from"] = {n: first.get(n) for n in ("what", "trained_on", "training")}
    return content


def _describe_data(data: Path) -> Any:
    """What the dataset says of itself."""
    manifest = Path(data) / "manifest.json"
    if not manifest.is_file():
        return {"dataset": Path(data).name}
    content = json.loads(manifest.read_text())
    generated = {name: content[name] for name in ("settings", "scenes") if name in content}
    return {"dataset": Path(data).name, "generate": generated}
