"""What the stages of a training share: batches, held-out batches, tables of the objects."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from ...assets.object_model import ObjectModel
from ...core.device import uses_bfloat16
from ...core.errors import InputError
from ...core.geometry import grid_matrix, make_transform
from ..evaluation.metrics import add_or_add_s
from ..networks.container import PoseNetworks
from ..solvers.rigid import RigidMotions
from ..training_data.dataset import TrainingSet
from .loader import Batch, Draw, NumberedBatches, collate, load, to_device


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
        name: of the stage.
        part: of the networks, which it trains.
        needs_depth: whether its dataset must have depth maps.
        validation: how many held-out batches are measured, and the samples in each.
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
    def network(self) -> Any:
        """The network that this stage is about."""
        return getattr(self.networks, self.part)

    @property
    def module(self) -> nn.Module:
        """What is trained."""
        return self.network

    def drawing(self, *, held_out: bool = False) -> Draw:
        """What draws a sample; of functions and data alone, so that it can go to a worker."""
        raise NotImplementedError

    def choosing(self) -> Callable[[np.random.Generator], int] | None:
        """What draws the one thing that the samples of a batch have in common, if any."""
        return None

    def batches(self, start: int) -> Generator[Batch, None, None]:
        """Batches from number ``start`` to the last, on the device.

        Raises:
            InputError: if the stage needs depth maps, and the dataset has none.
        """
        if self.needs_depth and self.train.pack.depth(int(self.train.targets[0])) is None:
            raise InputError(
                f"the stage {self.name} needs depth maps, and the dataset has none: make one with "
                "python -m two_view_pose generate --depth"
            )
        drawn = NumberedBatches(self.drawing(), self.batch, self.seed, self.choosing())
        return load(drawn, range(start, self.steps), self.workers, self.device)

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of a batch, and its parts for the log."""
        raise NotImplementedError

    def validate(self) -> dict[str, float]:
        """Numbers on held-out scenes."""
        raise NotImplementedError

    def held_out_batches(self) -> Iterator[Batch]:
        """The same batches of held-out samples each time, on the device."""
        draw, rng = self.drawing(held_out=True), np.random.default_rng(1)
        count, size = self.validation
        for _ in range(count):
            yield to_device(collate([draw(rng) for _ in range(size)]), self.device)

    def autocast(self) -> torch.autocast:
        """bfloat16 where the device is fast at it."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.bfloat16)


class FrozenFeatureStage(StageBase):
    """A network on top of the 2D features, which stay as they are.

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
        """Keypoints (..., 9, 3) of objects (...) in poses (..., 4, 4)."""
        return self.keypoints[index] @ T_cam_obj[..., :3, :3].mT + T_cam_obj[..., None, :3, 3]


class Answers(NamedTuple):
    """What a network says of the poses of a batch, and the truth.

    Attributes:
        keypoints: (B, 9, 3), m.
        motions: B poses.
        truth: (B, 9, 3) true keypoints, m.
        T_true: (B, 4, 4).
        objects: (B,) which object each is of.
    """

    keypoints: Tensor
    motions: RigidMotions
    truth: Tensor
    T_true: Tensor
    objects: Tensor


class KeypointStage(FrozenFeatureStage):
    """A network that says where the keypoints are in space."""

    def answers(self, batch: Batch) -> Answers:
        """Runs a held-out batch."""
        raise NotImplementedError

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """3D keypoint distance over the diameter, and ADD(-S) recall."""
        self.network.eval()
        errors: list[np.ndarray] = []
        hits: list[bool] = []
        for batch in self.held_out_batches():
            answers = self.answers(batch)
            distance = (answers.keypoints - answers.truth).norm(dim=-1).mean(1)
            errors.append((distance / self.diameters[answers.objects]).cpu().numpy())
            hits += poses_correct(answers, self.held_out.models)
        return {
            "keypoint_over_diameter": float(np.mean(np.concatenate(errors))),
            "add_recall": float(np.mean(hits)),
        }


def poses_correct(answers: Answers, models: Sequence[ObjectModel]) -> list[bool]:
    """Whether each pose's ADD, or ADD-S on a symmetric object, is below a tenth of the diameter."""
    correct = []
    rotations, translations, truths = (
        part.cpu().numpy().astype(np.float64) for part in (*answers.motions, answers.T_true)
    )
    indices = answers.objects.tolist()
    for R, t, T_true, index in zip(rotations, translations, truths, indices, strict=True):
        model = models[index]
        found = np.isfinite(R).all() and np.isfinite(t).all()
        error = add_or_add_s(make_transform(R, t), T_true, model) if found else np.inf
        correct.append(bool(error < 0.1 * model.diameter))
    return correct


def table(of_objects: Sequence[np.ndarray]) -> Tensor:
    """Arrays (n, ...) of N objects as one (N, n_max, ...), padded with each one's first row."""
    most = max(len(own) for own in of_objects)
    full = [np.concatenate([own, own[:1].repeat(most - len(own), 0)]) for own in of_objects]
    return torch.from_numpy(np.stack(full))
