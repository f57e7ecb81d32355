"""What stages of a training share, and those on single pictures: detector and 2D features."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..assets.object_model import ObjectModel
from .dataset import TrainingSet
from .detector import DetectorConfig, decode
from .device import uses_bfloat16
from .geometry import make_transform
from .loader import Batch, Draw, NumberedBatches, Sample, collate, load, to_device
from .losses import box_loss, direction_loss, heat_map_loss, mask_loss
from .metrics import add_or_add_s
from .networks import PoseNetworks
from .solvers import RigidMotions
from .target_sample import arrays_of, as_input
from .voting import vote


class StageBase:
    """What every stage holds.

    Args:
        networks: of which it trains a part, on the device where they are.
        train: where its batches come from.
        held_out: where it is validated.
        steps: batches in all.
        batch: samples in each, in each of the processes that train together.
        learning_rate: its maximum.
        seed: of the batches.
        workers: processes that draw them, see :func:`load`.

    Attributes:
        validation: how many held-out batches are measured, and the samples in each.
    """

    validation = (10, 32)

    def __init__(
        self, networks: PoseNetworks, train: TrainingSet, held_out: TrainingSet, *,
        steps: int, batch: int, learning_rate: float, seed: int, workers: int = 0
    ):  # fmt: skip
        self.networks = networks
        self.train = train
        self.held_out = held_out
        self.steps = steps
        self.batch = batch
        self.learning_rate = learning_rate
        self.seed = seed
        self.workers = workers
        self.device = networks.device
        self.bfloat16 = uses_bfloat16(self.device)

    @property
    def module(self) -> torch.nn.Module:
        """What is trained."""
        raise NotImplementedError

    @property
    def running(self) -> tuple[torch.nn.Module, ...]:
        """The networks that a batch runs through."""
        return (self.module,)

    def drawing(self, *, held_out: bool = False) -> Draw:
        """What draws a sample; of functions and data alone, so that it can go to a worker."""
        raise NotImplementedError

    def choosing(self) -> Callable[[np.random.Generator], int] | None:
        """What draws the one thing that the samples of a batch have in common, if any."""
        return None

    def batches(self, start: int) -> Iterator[Batch]:
        """Batches from number ``start`` to the last, on the device."""
        drawn = NumberedBatches(self.drawing(), self.batch, self.seed, self.choosing())
        return load(drawn, range(start, self.steps), self.workers, self.device)

    def held_out_batches(self) -> Iterator[Batch]:
        """The same batches of held-out samples each time, on the device."""
        draw, rng = self.drawing(held_out=True), np.random.default_rng(1)
        count, size = self.validation
        for _ in range(count):
            yield to_device(collate([draw(rng) for _ in range(size)]), self.device)

    def autocast(self) -> torch.autocast:
        """bfloat16 where the device is fast at it."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.bfloat16)


def table(of_objects: Sequence[np.ndarray]) -> Tensor:
    """Arrays (n, ...) of N objects as one (N, most, ...), filled up with each one's first row."""
    most = max(len(own) for own in of_objects)
    full = [np.concatenate([own, own[:1].repeat(most - len(own), 0)]) for own in of_objects]
    return torch.from_numpy(np.stack(full))


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
    rotations, translations = (part.cpu().numpy().astype(np.float64) for part in motions)
    for R, t, number, T in zip(
        rotations,
        translations,
        index.tolist(),
        T_true.cpu().numpy().astype(np.float64),
        strict=True,
    ):
        model = models[number]
        found = np.isfinite(R).all() and np.isfinite(t).all()
        error = add_or_add_s(make_transform(R, t), T, model) if found else np.inf
        correct.append(bool(error < 0.1 * model.diameter))
    return correct


class DetectorStage(StageBase):
    """Centre heat maps on whole frames."""

    name = "detector"
    validation = (40, 1)

    @property
    def module(self) -> torch.nn.Module:
        return self.networks.detector

    def drawing(self, *, held_out: bool = False) -> Draw:
        source = self.held_out if held_out else self.train
        return partial(draw_frame, source, self.networks.detector.config)

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self.module.train()
        with self.autocast():
            logits, predicted = self.module(as_input(batch["picture"]))
        heat_part = heat_map_loss(logits.float(), batch["heat"])
        box_part = box_loss(predicted.float(), batch["regression"], batch["weight"])
        return heat_part + box_part, {
            "heat": heat_part,
            "box": box_part,
        }

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """How far detections are from the truth, in sides of the region of interest."""
        self.module.eval()
        config = self.networks.detector.config
        errors, sizes = [], []
        for frame in self.held_out_batches():
            with self.autocast():
                logits, predicted = self.module(as_input(frame["picture"]))
            logits, predicted, heat, regression, weight = (
                part[0].float().cpu().numpy()
                for part in (
                    logits, predicted, frame["heat"], frame["regression"], frame["weight"]
                )
            )  # fmt: skip
            for index in np.flatnonzero(weight.any((1, 2))):
                found = decode(logits[index], predicted[index], np.eye(3), config)
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
        total = mask_part + 2 * direction_part
        return total, {
            "mask": mask_part,
            "direction": direction_part,
        }

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
                distances = []
                for S in model.symmetries:
                    T = T_cam_obj @ S
                    uvw = (model.keypoints @ T[:3, :3].T + T[:3, 3]) @ K.T
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
    names = ("picture", "heat", "regression", "weight")
    return dict(zip(names, source.draw_frame(rng, config), strict=True))


def draw_crop(source: TrainingSet, rng: np.random.Generator, index: int | None = None) -> Sample:
    """A crop of an object; without ``index`` each object is equally likely."""
    return arrays_of(source.draw_target(rng, index, with_depth=False))


def _choose(known: Sequence[int], rng: np.random.Generator) -> int:
    return int(rng.choice(known))
