"""Base classes of the training stages: batches, frozen features, validation of keypoints."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...assets.object_model import ObjectModel
from ...core.device import uses_bfloat16
from ...core.errors import InputError
from ...core.geometry import grid_matrix, make_transform
from ..evaluation.metrics import add_or_add_s
from ..networks.container import PoseNetworks
from ..solvers.rigid import RigidMotions
from ..training_data.dataset import TrainingSet
from .loader import Batch, NumberedBatches, SampleFunction, collate, load, to_device


class StageBase(ABC):
    """What :func:`run_stage` needs of a stage.

    Args:
        networks: on the device where they are trained.
        train: the training set.
        held_out: the validation set.
        steps: number of batches.
        batch: samples per batch of each rank.
        learning_rate: its maximum.
        seed: of the batches.
        workers: see :func:`load`.

    Attributes:
        name: of the stage.
        part: the part of the networks that it trains.
        needs_depth: whether its dataset must have depth maps.
        validation: number of held-out batches, and samples per batch.
    """

    name: str
    part: str
    needs_depth = False
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
    def module(self) -> Any:
        """The module that is trained."""
        return getattr(self.networks, self.part)

    @abstractmethod
    def sample_function(self, source: TrainingSet) -> SampleFunction:
        """Returns what draws a sample from a training set; picklable, for the workers."""

    def shared_function(self) -> Callable[[np.random.Generator], Any] | None:
        """Returns what draws the value that the samples of a batch share, if any."""
        return None

    def batches(self, start: int) -> Generator[Batch, None, None]:
        """Returns the batches from number ``start`` to the last, on the device.

        Raises:
            InputError: if the stage needs depth maps, and the dataset has none.
        """
        if self.needs_depth and self.train.pack.depth(int(self.train.targets[0])) is None:
            raise InputError(
                f"the stage {self.name} needs depth maps, and the dataset has none: make one with "
                "python -m two_view_pose generate --depth"
            )
        draw, draw_shared = self.sample_function(self.train), self.shared_function()
        batches = NumberedBatches(draw, self.batch, self.seed, draw_shared)
        return load(batches, range(start, self.steps), self.workers, self.device)

    @abstractmethod
    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Returns the loss of a batch, and its terms by name for the log."""

    @abstractmethod
    def validate(self) -> dict[str, float]:
        """Returns metrics on the validation set, by name."""

    def held_out_batches(self) -> Iterator[Batch]:
        """Yields the validation batches, the same each time, on the device."""
        draw, rng = self.sample_function(self.held_out), np.random.default_rng(1)
        count, size = self.validation
        for _ in range(count):
            yield to_device(collate([draw(rng) for _ in range(size)]), self.device)

    def autocast(self) -> torch.autocast:
        """Autocast to bfloat16 where the device is fast at it."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.bfloat16)


class FrozenFeatureStage(StageBase):
    """A network on top of frozen 2D features.

    Attributes:
        keypoints: (N, 9, 3) of the N objects, m.
        diameters: (N,) m.
        to_grid: (3, 3) from pixels of a crop to those of its features.
    """

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.networks.features.requires_grad_(False)
        models, to_grid = self.train.models, grid_matrix(self.networks.features.config.stride)
        self.keypoints, self.diameters, self.to_grid = (
            torch.from_numpy(np.asarray(values)).float().to(self.device)
            for values in ([m.keypoints for m in models], [m.diameter for m in models], to_grid)
        )

    def place(self, T_cam_obj: Tensor, index: Tensor) -> Tensor:
        """Returns the keypoints (..., 9, 3) of objects (...) in poses (..., 4, 4)."""
        return self.keypoints[index] @ T_cam_obj[..., :3, :3].mT + T_cam_obj[..., None, :3, 3]


class Predictions(NamedTuple):
    """Predicted and true keypoints and poses of a batch.

    Attributes:
        keypoints: (B, 9, 3), m.
        motions: B poses.
        truth: (B, 9, 3) true keypoints, m.
        T_true: (B, 4, 4).
        objects: (B,) object indices.
    """

    keypoints: Tensor
    motions: RigidMotions
    truth: Tensor
    T_true: Tensor
    objects: Tensor


class KeypointStage(FrozenFeatureStage):
    """A network that predicts 3D keypoints."""

    @abstractmethod
    def predict(self, batch: Batch) -> Predictions:
        """Runs a validation batch."""

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """3D keypoint distance over the diameter, and ADD(-S) recall."""
        getattr(self.networks, self.part).eval()
        errors: list[np.ndarray] = []
        hits: list[bool] = []
        for batch in self.held_out_batches():
            predictions = self.predict(batch)
            distance = (predictions.keypoints - predictions.truth).norm(dim=-1).mean(1)
            errors.append((distance / self.diameters[predictions.objects]).cpu().numpy())
            hits += poses_correct(predictions, self.held_out.models)
        return {
            "keypoint_over_diameter": float(np.mean(np.concatenate(errors))),
            "add_recall": float(np.mean(hits)),
        }


def poses_correct(predictions: Predictions, models: Sequence[ObjectModel]) -> list[bool]:
    """Whether each pose's ADD, or ADD-S on a symmetric object, is below a tenth of the diameter."""
    correct = []
    rotations, translations, truths = (
        part.cpu().numpy().astype(np.float64) for part in (*predictions.motions, predictions.T_true)
    )
    indices = predictions.objects.tolist()
    for R, t, T_true, index in zip(rotations, translations, truths, indices, strict=True):
        model = models[index]
        finite = np.isfinite(R).all() and np.isfinite(t).all()
        error = add_or_add_s(make_transform(R, t), T_true, model) if finite else np.inf
        correct.append(bool(error < 0.1 * model.diameter))
    return correct


def padded_stack(arrays: Sequence[np.ndarray]) -> Tensor:
    """Stacks N arrays (n, ...) to (N, n_max, ...), padding each with its first row."""
    longest = max(map(len, arrays))
    full = [np.concatenate([rows, rows[:1].repeat(longest - len(rows), 0)]) for rows in arrays]
    return torch.from_numpy(np.stack(full))
