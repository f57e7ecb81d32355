"""The command ``train-estimator``: trains the stages in order and writes the weights file."""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...core.errors import InputError
from ..bop.dataset import read_dataset, require_masks
from ..bop.find_dataset import find_dataset
from ..methods import DEFAULT_METHOD, METHOD_TABLE, OPTIONAL_PARTS
from .config import STAGE_DEFAULTS, TrainEstimatorConfig
from .objects import training_objects
from .record import TrainingLog, header

if TYPE_CHECKING:
    import torch

    from ..networks.container import PoseNetworks
    from ..training_data.dataset import TrainingSet
    from .stage_base import StageBase


def train_estimator(config: TrainEstimatorConfig) -> Path:
    """Trains and returns the path of the weights file.

    Raises:
        InputError: if the configuration or the data is wrong, or there is no such device.
    """
    deadline = time.monotonic() + 60 * config.max_minutes if config.max_minutes else math.inf
    config = replace(config, data=find_dataset(config.data), stages=config.chosen_stages)
    if not (config.data / f"packed_{config.split}").is_dir():
        require_masks(read_dataset(config.data, config.split))  # before meshes are read
    from .distributed import process_group, rank_device

    device = rank_device(config.device)
    with process_group(device):
        return _train(config, device, deadline)


def _train(config: TrainEstimatorConfig, device: torch.device, deadline: float) -> Path:
    """Trains on each rank; rank 0 writes the files."""
    import torch

    from ...core.device import describe, uses_bfloat16
    from ..networks.weights import find_weights, save_weights
    from .distributed import rank, rank_zero_first, threads_per_rank, world_size
    from .trainer import disable_malloc_trim

    if config.threads or world_size() > 1:
        torch.set_num_threads(config.threads or threads_per_rank())
    disable_malloc_trim()
    torch.manual_seed(config.seed)
    if config.base is not None:
        find_weights(config.base)  # an unknown one is an error before hours of training
    networks = start_networks(config).to(device)
    steps = {name: config.stage(name, len(networks.objects)).steps for name in STAGE_DEFAULTS}
    plan = [f"{name} ({count} steps)" for name, count in steps.items() if name in config.stages]
    print(f"training {', '.join(networks.objects)}: {', '.join(plan)}")
    processes = f", {world_size()} processes" if world_size() > 1 else ""
    dtype = "bfloat16" if uses_bfloat16(device) else "float32"
    print(f"on {describe(device)} in {dtype}{processes}")
    train, held_out = rank_zero_first(lambda: open_data(config, networks))
    if config.compile:
        for network in networks.children():
            network.compile()  # when it first runs
    config.out.mkdir(parents=True, exist_ok=True)
    log = TrainingLog(config.out / "log.jsonl", resume=config.resume)
    done: dict[str, int] = {}
    for name in STAGE_DEFAULTS:
        step = train_stage(config, name, networks, train, held_out, log, deadline)
        if step is not None:
            done[name] = step
    path = config.out / "weights.safetensors"
    if rank() > 0:
        return path
    networks.cpu()
    fields = header(config, networks, done, log.held_out)
    save_weights(networks, path, fields, surfaces=config.store_meshes, base=config.base)
    if config.json is not None:
        log.write_results(config)
    print(f"weights: {path}")
    unfinished = [
        f"{name} ({done.get(name, 0)} of {steps[name]} steps)"
        for name in config.stages
        if done.get(name, 0) < steps[name]
    ]
    if unfinished:
        print(
            f"stopped after {config.max_minutes:g} minutes; the same command resumes with "
            f"{', '.join(unfinished)}"
        )
    else:
        print(next_command(networks, done, path))
    return path


def next_command(networks: PoseNetworks, done: Collection[str], path: Path) -> str:
    """Suggests how to evaluate the weights at ``path``, or what to train before that.

    Args:
        networks: the trained networks.
        done: the stages of the training, in order.
        path: the weights.
    """
    missing = [part for part in ("detector", "features") if part not in networks.trained]
    if missing:
        return (
            f"these weights cannot be evaluated until {' and '.join(missing)} are trained: the "
            f"same command with --stages {' '.join(missing)}"
        )
    last = [*done][-1] if done else ""
    with_last = [m.name for m in METHOD_TABLE.values() if last in m.parts]
    method = with_last[0] if last in OPTIONAL_PARTS else DEFAULT_METHOD
    if method == DEFAULT_METHOD and "volume" not in networks.trained:
        method = "pnp"  # the best two-view method that needs 2D features only
    return f"evaluate them: python -m two_view_pose evaluate --method {method} --weights {path}"


def start_networks(config: TrainEstimatorConfig) -> PoseNetworks:
    """Returns the initial networks; see :func:`start_from` for what it raises."""
    from ..networks.container import NetworkConfig, PoseNetworks

    objects = training_objects(config.data, config.objects, config.unit)
    networks = PoseNetworks(objects, NetworkConfig(preset=config.preset))
    encoders = networks.detector.encoder, networks.features.encoder
    if config.init is not None:
        start_from(config, networks)
    elif config.pretrained:
        for encoder in encoders:
            encoder.load_pretrained()
    if config.frozen_stages and (config.pretrained or config.init is not None):
        for encoder in encoders:
            encoder.freeze(config.frozen_stages)
    return networks


def start_from(config: TrainEstimatorConfig, networks: PoseNetworks) -> None:
    """Loads the compatible parts of the weights ``config.init``, and prints which they are.

    Raises:
        FileNotFoundError: if there are no such weights.
        InputError: if they are damaged, or lack 2D features or objects that none of the requested
            stages trains.
    """
    from ..networks.weights import find_weights, read_networks
    from .transfer import transfer_weights

    assert config.init is not None
    other = read_networks(find_weights(config.init))
    transfer = transfer_weights(other, networks)
    print(f"weights {config.init}\n{transfer}")
    checkpoints = {
        name for name in STAGE_DEFAULTS if (config.out / f"{name}.safetensors").is_file()
    }
    trained = checkpoints.union(config.chosen_stages)
    stages_of = {"detector": {"detector"}, "features": {"features", "decoders"}}
    missing = [n for n in stages_of if n in transfer.incomplete and not stages_of[n] & trained]
    if missing:
        raise InputError(
            f"the weights {config.init} know {', '.join(other.objects)}, and the training asks for "
            f"{', '.join(networks.objects)}: add {' and '.join(missing)} to --stages, which must "
            f"learn {', '.join(transfer.new)}"
        )
    if "decoders" in config.chosen_stages and "features" not in {*transfer.parts, *trained}:
        raise InputError(
            f"the weights {config.init} hold no trained 2D features for the decoders to build on: "
            "add features to --stages"
        )


def open_data(
    config: TrainEstimatorConfig, networks: PoseNetworks
) -> tuple[TrainingSet, TrainingSet]:
    """Returns the training and the validation set; packs the dataset first if it is not."""
    from ..training_data.augmentation import AugmentationConfig
    from ..training_data.crop_packing import pack_dataset
    from ..training_data.cut_and_paste import CutAndPasteConfig
    from ..training_data.dataset import TrainingSet

    pack = pack_dataset(config.data, networks.objects, split=config.split)
    p, strong = config.cut_and_paste, config.augmentation == "strong"
    open_set = partial(
        TrainingSet, pack, networks.objects, networks.config.features,
        AugmentationConfig.strong() if strong else AugmentationConfig(),
        validation=config.validation,
    )  # fmt: skip
    paste = CutAndPasteConfig(p, p, collages=0.5 * strong) if p else None
    return open_set(cut_and_paste=paste), open_set(held_out=True)


def train_stage(
    config: TrainEstimatorConfig,
    name: str,
    networks: PoseNetworks,
    train: TrainingSet,
    held_out: TrainingSet,
    log: TrainingLog,
    deadline: float = math.inf,
) -> int | None:
    """Runs a stage if it is requested, else restores its checkpoint if there is one.

    Returns the step that the stage has reached; None if it is not part of this training.
    ``deadline`` is a time of ``time.monotonic()``.
    """
    from .checkpoints import load_checkpoint, read_counters
    from .distributed import broadcast_decision
    from .loader import default_workers
    from .trainer import LoopConfig, run_stage

    checkpoint = config.out / f"{name}.safetensors"
    requested = name in config.stages and broadcast_decision(time.monotonic() < deadline)
    if not requested and not checkpoint.is_file():
        return None
    settings = config.stage(name, len(networks.objects))
    extra: dict[str, Any] = {}
    if name == "volume":
        degrees, millimeters = config.pose_noise
        extra = {
            "pose_noise": (degrees, millimeters / 1000),
            "pose_weight": config.pose_loss,
            "tune_features": config.tune_features,
        }
    elif name == "decoders":
        extra = {"tune_encoder": config.tune_encoder}
    workers = default_workers(networks.device) if config.workers is None else config.workers
    stage = _stage_class(name)(
        networks, train, held_out, steps=settings.steps, batch=settings.batch,
        learning_rate=settings.learning_rate, seed=config.seed, workers=workers, **extra,
    )  # fmt: skip
    if requested:
        loop = LoopConfig(
            out=config.out,
            checkpoint_every=config.checkpoint_every,
            resume=config.resume,
            deadline=deadline,
            lr_cycles=config.lr_cycles,
        )
        step = run_stage(stage, loop, log)
    else:
        load_checkpoint(stage.module, checkpoint)
        step = read_counters(checkpoint)["step"]
    # Parts trained on the previous features are invalid; the cascade reads the encoder only.
    if name == "features":
        networks.trained -= {"volume", "cascade", "points"}
    elif name == "decoders":
        networks.trained -= {"volume", "points"}
    elif name == "volume" and config.tune_features:
        networks.trained -= {"cascade", "points"}
    networks.trained |= {"features" if name == "decoders" else name}
    return step


def _stage_class(name: str) -> type[StageBase]:
    from .cascade_stage import CascadeStage
    from .point_stage import PointStage
    from .stages import DecoderStage, DetectorStage, FeatureStage
    from .volume_stage import VolumeStage

    classes = (DetectorStage, FeatureStage, DecoderStage, VolumeStage, CascadeStage, PointStage)
    return {stage.name: stage for stage in classes}[name]
