"""The stages that train on single images: detector and 2D features."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.geometry import project, transform
from ..networks.detector import DetectorConfig, decode
from ..networks.voting import vote
from ..training_data.dataset import TrainingSet
from ..training_data.target_sample import arrays_of, as_input
from .loader import Batch, Draw, Sample
from .losses import box_loss, direction_loss, heat_map_loss, mask_loss
from .stage_base import StageBase


class DetectorStage(StageBase):
    """Center heat maps on whole frames."""

    name = part = "detector"
    validation = (40, 1)

    def drawing(self, *, held_out: bool = False) -> Draw:
        source = self.held_out if held_out else self.train
        return partial(draw_frame, source, self.networks.detector.config)

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self.module.train()
        with self.autocast():
            logits, predicted = self.module(as_input(batch["image"]))
        heat_part = heat_map_loss(logits.float(), batch["heat"])
        box_part = box_loss(predicted.float(), batch["regression"], batch["weight"])
        return heat_part + box_part, {"heat": heat_part, "box": box_part}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """How far detections are from the truth, in sides of the region of interest."""
        self.module.eval()
        config = self.networks.detector.config
        errors, sizes = [], []
        for frame in self.held_out_batches():
            with self.autocast():
                logits, predicted = self.module(as_input(frame["image"]))
            logits, predicted, heat, regression, weight = (
                part[0].float().cpu().numpy()
                for part in (
                    logits, predicted, frame["heat"], frame["regression"], frame["weight"]
                )
            )  # fmt: skip
            for index in np.flatnonzero(weight.any((1, 2))):
                found = decode(logits[index], predicted[index], np.eye(3), config)
                true = decode(heat[index] * 20 - 10, regression[index], np.eye(3), config)
                errors.append(np.linalg.norm(found.center - true.center) / true.side)
                sizes.append(abs(np.log(found.side / true.side)))
        return {
            "center_error": float(np.median(errors)),
            "missed": float(np.mean(np.array(errors) > 0.2)),
            "size_error": float(np.median(sizes)),
        }


class CropStage(StageBase):
    """What is the same whether the 2D network has one decoder or many: its loss and its measure."""

    part = "features"

    def drawing(self, *, held_out: bool = False) -> Draw:
        return partial(draw_crop, self.held_out if held_out else self.train)

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self.module.train()
        with self.autocast():
            out = self.module(as_input(batch["crop"]), batch["object"])
        mask_part = mask_loss(out.mask_logits.float(), batch["mask"])
        direction_part = direction_loss(
            out.directions.float(), batch["directions"], (batch["mask"] > 0.4).float()
        )
        return mask_part + 2 * direction_part, {"mask": mask_part, "direction": direction_part}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Distance of voted keypoints from the (nearest equivalent) truth in crop pixels."""
        self.module.eval()
        stride = self.networks.features.config.stride
        errors: list[np.ndarray] = []
        for batch in self.held_out_batches():
            with self.autocast():
                out = self.module(as_input(batch["crop"]), batch["object"])
            mean, poses, cameras = (
                part.cpu().numpy().astype(np.float64)
                for part in (vote(out)[0], batch["T_cam_obj"], batch["K"])
            )
            for index, voted, T_cam_obj, K in zip(
                batch["object"].tolist(), mean, poses, cameras, strict=True
            ):
                model = self.held_out.models[index]
                pixels = voted * stride + (stride - 1) / 2
                distances = [
                    np.linalg.norm(pixels - project(transform(T, model.keypoints), K), axis=1)
                    for T in T_cam_obj @ model.symmetries
                ]
                errors.append(min(distances, key=np.mean))
        flat = np.concatenate(errors)
        return {
            "vote_error_px": float(np.median(flat)),
            "vote_error_p80": float(np.quantile(flat, 0.8)),
        }


class FeatureStage(CropStage):
    """Segmentation and vector fields on single crops, by one decoder for all objects."""

    name = "features"

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.networks.features.share_decoders()


class DecoderStage(CropStage):
    """A decoder for each object, each on its own crops.

    Args:
        args: of :class:`StageBase`.
        tune_encoder: whether what the decoders share goes on learning; else it stays as it is.
        kwargs: of :class:`StageBase`.
    """

    name = "decoders"

    def __init__(self, *args: Any, tune_encoder: bool = False, **kwargs: Any):
        super().__init__(*args, **kwargs)
        features = self.networks.features
        features.split_decoders()
        if tune_encoder:
            return
        for part in (features.encoder, features.embedding, features.film16, features.film4):
            part.requires_grad_(False)

    def choosing(self) -> Callable[[np.random.Generator], int]:
        """Batches are of one object each: a batch norm must not see others."""
        return partial(_choose, self.train.known)


def draw_frame(source: TrainingSet, config: DetectorConfig, rng: np.random.Generator) -> Sample:
    """A whole frame and what the detector should say of it."""
    names = ("image", "heat", "regression", "weight")
    return dict(zip(names, source.draw_frame(rng, config), strict=True))


def draw_crop(source: TrainingSet, rng: np.random.Generator, index: int | None = None) -> Sample:
    """A crop of an object; without ``index`` each object is equally likely."""
    return arrays_of(source.draw_target(rng, index, with_depth=False))


def _choose(known: Sequence[int], rng: np.random.Generator) -> int:
    return int(rng.choice(known))
