"""What stages of a training share, and those on single pictures: detector and 2D features."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..assets.object_model import ObjectModel
from .dataset import TrainingSet
from .detector import decode
from .device import uses_bfloat16
from .features import Features2D
from .geometry import make_transform
from .inference import vote
from .loader import batches, own_generators, prepared
from .losses import box_loss, direction_loss, heat_map_loss, mask_loss
from .metrics import add_or_add_s
from .networks import PoseNetworks
from .solvers import RigidMotions
from .target_sample import TargetSample, stack_targets

_Frame = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class StageBase:
    """What every stage holds.

    Args:
        networks: of which it trains a part.
        train: where its batches come from.
        held_out: where it is validated.
        steps: batches in all.
        batch: samples in each, in each of the processes that train together.
        learning_rate: its maximum.
        seed: of the batches.
    """

    def __init__(
        self, networks: PoseNetworks, train: TrainingSet, held_out: TrainingSet, *,
        steps: int, batch: int, learning_rate: float, seed: int
    ):  # fmt: skip
        self.networks = networks
        self.train = train
        self.held_out = held_out
        self.steps = steps
        self.batch = batch
        self.learning_rate = learning_rate
        self.seed = seed
        self.device = networks.device
        self.bfloat16 = uses_bfloat16(self.device)

    def autocast(self) -> torch.autocast:
        """bfloat16 where the device is fast at it."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.bfloat16)


def vote_apart(features: Features2D, size: int) -> tuple[Tensor, Tensor]:
    """Votes for ``size`` crops at a time, so that the batch around them does not change them.

    That costs no more than all at once.

    Returns:
        mean (B, 9, 2) and covariance (B, 9, 2, 2) in pixels of the feature grid.
    """
    parts = zip(*(part.split(size) for part in features), strict=True)
    mean, covariance, _ = zip(*(vote(Features2D(*part)) for part in parts), strict=True)
    return torch.cat(mean), torch.cat(covariance)


def correct_poses(
    motions: RigidMotions, index: Tensor, T_true: Tensor, models: Sequence[ObjectModel]
) -> list[bool]:
    """Whether each pose's ADD, or ADD-S on a symmetric object, is below a tenth of the diameter.

    Args:
        motions: B poses.
        index: (B,) of which object.
        T_true: (B, 4, 4).
        models: the objects.
    """
    correct = []
    rotations, translations = (part.double().numpy() for part in motions)
    for R, t, number, T in zip(
        rotations, translations, index.tolist(), T_true.double().numpy(), strict=True
    ):
        model = models[number]
        found = np.isfinite(R).all() and np.isfinite(t).all()
        error = add_or_add_s(make_transform(R, t), T, model) if found else np.inf
        correct.append(bool(error < 0.1 * model.diameter))
    return correct


class DetectorStage(StageBase):
    """Centre heat maps on whole frames."""

    name = "detector"

    @property
    def module(self) -> torch.nn.Module:
        return self.networks.detector

    def batches(self, start: int) -> Iterator[list[_Frame]]:
        config = self.networks.detector.config
        return batches(lambda rng: self.train.draw_frame(rng, config), self.batch, self.seed, start)

    def loss(self, batch: list[_Frame]) -> tuple[Tensor, dict[str, Tensor]]:
        self.module.train()
        frames, heat, regression, weight = (
            torch.from_numpy(np.stack(part)) for part in zip(*batch, strict=True)
        )
        with self.autocast():
            logits, predicted = self.module(frames.permute(0, 3, 1, 2).float())
        heat_part = heat_map_loss(logits.float(), heat)
        box_part = box_loss(predicted.float(), regression, weight)
        return heat_part + box_part, {
            "heat": heat_part,
            "box": box_part,
        }

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """How far detections are from the truth, in sides of the region of interest."""
        self.module.eval()
        config = self.networks.detector.config
        rng = np.random.default_rng(1)
        errors, sizes = [], []
        for _ in range(40):
            picture, heat, regression, weight = self.held_out.draw_frame(rng, config)
            frames = torch.from_numpy(picture).permute(2, 0, 1)[None].float()
            with self.autocast():
                logits, predicted = self.module(frames)
            for index in np.flatnonzero(weight.any((1, 2))):
                found = decode(
                    logits[0, index].float().numpy(), predicted[0, index].float().numpy(),
                    np.eye(3), config,
                )  # fmt: skip
                true = decode(heat[index] * 20 - 10, regression[index], np.eye(3), config)
                errors.append(np.linalg.norm(found.centre - true.centre) / true.side)
                sizes.append(abs(np.log(found.side / true.side)))
        return {
            "centre_error": float(np.median(errors)),
            "missed": float(np.mean(np.array(errors) > 0.2)),
            "size_error": float(np.median(sizes)),
        }


class CropStage(StageBase):
    """What is the same whether the 2D network has one decoder or many: its loss and its measure."""

    @property
    def module(self) -> torch.nn.Module:
        return self.networks.features

    def loss(self, batch: list[TargetSample]) -> tuple[Tensor, dict[str, Tensor]]:
        self.module.train()
        tensors = stack_targets(batch)
        with self.autocast():
            out = self.module(tensors["crop"], tensors["object"])
        mask_part = mask_loss(out.mask_logits.float(), tensors["mask"])
        direction_part = direction_loss(
            out.directions.float(), tensors["directions"], (tensors["mask"] > 0.4).float()
        )
        total = mask_part + 2 * direction_part
        return total, {
            "mask": mask_part,
            "direction": direction_part,
        }

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """Distance of voted keypoints from the (nearest equivalent) truth in crop pixels."""
        self.module.eval()
        rng = np.random.default_rng(1)
        stride = self.networks.features.config.stride
        errors: list[np.ndarray] = []
        for _ in range(10):
            samples = [self.held_out.draw_target(rng) for _ in range(32)]
            tensors = stack_targets(samples)
            with self.autocast():
                out = self.module(tensors["crop"], tensors["object"])
            mean, _, _ = vote(out)
            for sample, voted in zip(samples, mean.numpy(), strict=True):
                model = self.held_out.models[sample.object_index]
                distances = []
                for S in model.symmetries:
                    T = sample.T_cam_obj @ S
                    uvw = (model.keypoints @ T[:3, :3].T + T[:3, 3]) @ sample.K.T
                    pixels = voted * stride + (stride - 1) / 2
                    distances.append(np.linalg.norm(pixels - uvw[:, :2] / uvw[:, 2:], axis=1))
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

    def batches(self, start: int) -> Iterator[list[TargetSample]]:
        draw = partial(self.train.draw_target, with_depth=False)
        return batches(draw, self.batch, self.seed, start)


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

    def batches(self, start: int) -> Iterator[list[TargetSample]]:
        """Batches of one object each: a batch norm must not see others."""

        def make(rng: np.random.Generator) -> list[TargetSample]:
            index = int(rng.choice(self.train.known))
            return [
                self.train.draw_target(own, index, with_depth=False)
                for own in own_generators(rng, self.batch)
            ]

        return prepared(make, self.seed, start)
