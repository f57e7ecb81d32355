"""Training stages on single images: detector and 2D features."""

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
from ..training_data.target_sample import as_input, target_arrays
from .loader import Batch, Sample, SampleFunction
from .losses import box_loss, features_loss, heat_map_loss
from .stage_base import StageBase

_CROPS_PER_OBJECT = 32
"""Crops of one object that a batch of the decoders shows."""


class DetectorStage(StageBase):
    """Center heat maps on full frames."""

    name = part = "detector"
    validation = (40, 1)

    def sample_function(self, source: TrainingSet) -> SampleFunction:
        return partial(draw_frame, source, self.networks.detector.config)

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self.module.train()
        with self.autocast():
            logits, predicted = self.module(as_input(batch["image"]))
        heat = heat_map_loss(logits.float(), batch["heat"])
        box = box_loss(predicted.float(), batch["regression"], batch["weight"])
        return heat + box, {"heat": heat, "box": box}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Errors of center and (log) size in units of the ROI's side, and the miss rate."""
        self.module.eval()
        config = self.networks.detector.config
        errors, sizes = [], []
        for frame in self.held_out_batches():
            with self.autocast():
                outputs = self.module(as_input(frame["image"]))
            targets = (frame[name] for name in ("heat", "regression", "weight"))
            logits, predicted, heat, regression, weight = (
                part[0].float().cpu().numpy() for part in (*outputs, *targets)
            )
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
    """Segmentation and vector fields on single crops: loss and validation."""

    part = "features"

    def sample_function(self, source: TrainingSet) -> SampleFunction:
        return partial(draw_crop, source)

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self.module.train()
        with self.autocast():
            out = self.module(as_input(batch["crop"]), batch["object"])
        return features_loss(out, batch["mask"], batch["directions"])

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Distance of voted keypoints from the nearest equivalent truth in crop pixels."""
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
    """One decoder shared by all objects."""

    name = "features"

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.networks.features.share_decoders()


class DecoderStage(CropStage):
    """One decoder per object, each trained on crops of its object.

    A batch shows one object, a larger one several, so that each decoder's batch norms see enough
    crops.

    Args:
        args: of :class:`StageBase`.
        tune_encoder: train the encoder and the object embedding too instead of freezing them.
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

    def shared_function(self) -> Callable[[np.random.Generator], Sequence[int]]:
        return partial(draw_objects, self.train, max(1, self.batch // _CROPS_PER_OBJECT))


def draw_frame(source: TrainingSet, config: DetectorConfig, rng: np.random.Generator) -> Sample:
    """Draws a full frame and the detector's targets."""
    names = ("image", "heat", "regression", "weight")
    return dict(zip(names, source.draw_frame(rng, config), strict=True))


def draw_objects(source: TrainingSet, count: int, rng: np.random.Generator) -> Sequence[int]:
    """Draws up to ``count`` different objects of a training set."""
    if count == 1:
        return [source.draw_object(rng)]
    return rng.permutation(source.known)[:count].tolist()


def draw_crop(source: TrainingSet, rng: np.random.Generator, objects: Sequence[int] = ()) -> Sample:
    """Draws a crop of one of some objects, of all by default; each is equally likely."""
    index = None
    if objects:
        index = objects[0] if len(objects) == 1 else int(rng.choice(objects))
    return target_arrays(source.draw_target(rng, index, with_depth=False))
