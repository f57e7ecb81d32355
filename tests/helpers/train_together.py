"""Run by each of two processes in ``test_distributed.py``: a gradient, and trainings."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import Tensor
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.training import optimizer
from two_view_pose.pose_estimator.training.config import STAGE_DEFAULTS, TrainEstimatorConfig
from two_view_pose.pose_estimator.training.distributed import (
    data_parallel,
    process_group,
    rank,
    rank_zero_first,
    world_size,
)
from two_view_pose.pose_estimator.training.objects import training_objects
from two_view_pose.pose_estimator.training.stages import DecoderStage, FeatureStage
from two_view_pose.pose_estimator.training.train_estimator import train_estimator
from two_view_pose.pose_estimator.training.trainer import StageLoss
from two_view_pose.pose_estimator.training_data import crop_packing
from two_view_pose.pose_estimator.training_data.crop_packing import pack_dataset
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet

BATCH = 4
"""Samples per batch of all ranks."""

STEPS = 3
CPU = torch.device("cpu")


def gradient(dataset: Path) -> dict[str, Tensor]:
    """Returns the gradient of a batch of one object, with frozen batch norms."""
    torch.manual_seed(0)
    objects = training_objects(dataset, ())
    networks = PoseNetworks(objects)
    source = TrainingSet(pack_dataset(dataset, objects), objects, networks.config.features)
    stage = DecoderStage(
        networks, source, source, steps=1, batch=BATCH // world_size(), learning_rate=1.0, seed=3,
        tune_encoder=True,
    )  # fmt: skip
    stage.bfloat16 = False
    stage.module.eval()
    stage.module.train = lambda mode=True: stage.module  # type: ignore[method-assign]
    together = data_parallel(StageLoss(stage))
    together(next(stage.batches(0)))[0].backward()
    return {
        name: (torch.zeros_like(p) if p.grad is None else p.grad).contiguous()
        for name, p in stage.module.named_parameters()
    }


def train(dataset: Path, out: Path, stop_at: int | None = None) -> FeatureStage:
    """Trains 2D features, interrupted after ``stop_at`` steps."""
    loss, count, stages = FeatureStage.loss, 0, []

    def interrupted(self: FeatureStage, batch: dict) -> tuple:
        nonlocal count
        stages.append(self)
        if count == stop_at:
            raise KeyboardInterrupt
        count += 1
        return loss(self, batch)

    FeatureStage.loss = interrupted  # type: ignore[method-assign]
    config = TrainEstimatorConfig(
        data=dataset, out=out, stages=("features",), feature_steps=STEPS, pretrained=False,
        validation=0.3, threads=1, workers=0, device="cpu", checkpoint_every=-1.0,
    )  # fmt: skip
    try:
        train_estimator(config)
    except KeyboardInterrupt:
        print("interrupted")
    finally:
        FeatureStage.loss = loss  # type: ignore[method-assign]
    return stages[-1]


def main(dataset: Path, out: Path) -> None:
    """Writes the results into files of ``out`` that are named by the rank."""
    report: dict[str, object] = {"packed": 0}
    encode = crop_packing.encode_image

    def count_packs(*args: Any) -> bytes:
        report["packed"] = 1
        return encode(*args)

    crop_packing.encode_image = count_packs  # type: ignore[assignment]
    STAGE_DEFAULTS["features"] = replace(STAGE_DEFAULTS["features"], batch=BATCH // 2)
    FeatureStage.validate = lambda self: {"figure": float(rank())}  # type: ignore[method-assign]
    optimizer.MIN_SIDE = 10**9  # AdamW alone, which is quicker
    torch.set_num_threads(1)
    with process_group(CPU):
        train(dataset, out / "whole")
        train(dataset, out / "killed", stop_at=1)
        ended = train(dataset, out / "killed").module.state_dict()
        ended = {name: tensor.contiguous() for name, tensor in ended.items()}
        save_file(ended, out / f"ended-{rank()}.safetensors")
        save_file(gradient(dataset), out / f"gradient-{rank()}.safetensors")
        try:
            rank_zero_first(partial(int, "none"))
        except ValueError as error:
            report["error"] = str(error)
        (out / f"report-{rank()}.json").write_text(json.dumps(report))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
