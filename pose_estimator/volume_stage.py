"""The training of ``mid``'s volume: pairs of crops, on top of frozen 2D features."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from .geometry import grid_matrix, make_transform
from .loader import batches
from .losses import distribution_loss, keypoint_loss, pose_loss
from .solvers import RigidMotions, solve
from .stages import StageBase, correct_poses, vote_apart
from .symmetry import keypoint_permutations
from .target_sample import TargetSample, generator_of, stack_targets
from .volume import LevelOutput, ViewMaps

_Pair = tuple[TargetSample, TargetSample, np.ndarray]

_KEYPOINT_WEIGHT = 4.0
_DISTRIBUTION_WEIGHT = 0.2
"""The paper's beta2 and beta3; beta1, the pose loss's, is an argument."""


class VolumeStage(StageBase):
    """The volume on pairs of views; of the 2D network only the lifted map is trained with it.

    The loss is the paper's, the sum over the levels of beta1 pose + beta2 keypoint + beta3 KL
    divergence. Only where the volume's configuration says so (the preset ``paper``) is the coarse
    level's pose part of it; elsewhere it is the fine level's alone.

    Args:
        args: of :class:`StageBase`.
        pose_noise: largest error of the relative pose that the volume is told, as rotation in
            degrees and translation in metres; see :func:`perturb`.
        pose_weight: of the pose loss; 0 leaves it out.
        kwargs: of :class:`StageBase`.
    """

    name = "volume"

    def __init__(
        self,
        *args: Any,
        pose_noise: tuple[float, float] = (0.0, 0.0),
        pose_weight: float = 1.0,
        **kwargs: Any,
    ):
        super().__init__(*args, **kwargs)
        self.pose_noise = pose_noise
        self.pose_weight = pose_weight
        self.networks.features.requires_grad_(False)
        heads = self.networks.features.volume_heads.requires_grad_(True)
        self.module = torch.nn.ModuleDict({"volume": self.networks.volume, "heads": heads})
        models = self.train.models
        self.keypoints = torch.from_numpy(np.stack([m.keypoints for m in models])).float()
        self.diameters = torch.tensor([m.diameter for m in models], dtype=torch.float32)
        self.permutations = [keypoint_permutations(m.keypoints, m.symmetries) for m in models]

    def batches(self, start: int) -> Iterator[list[_Pair]]:
        draw = partial(self.train.draw_pair, with_depth=False)
        return batches(draw, self.batch, self.seed, start)

    def forward(
        self,
        batch: list[_Pair],
        rng: np.random.Generator | None = None,
        pose_noise: tuple[float, float] = (0.0, 0.0),
    ) -> dict[str, Any]:
        """Runs a batch of pairs; the guess of the centre is the truth with noise.

        Args:
            batch: the pairs.
            rng: of the noise; None = each pair has its own, wherever in a batch it stands.
            pose_noise: of the relative pose that the volume is told, and nothing else.
        """
        networks = self.networks
        networks.features.eval()
        count = len(batch)
        tensors = stack_targets([s for first, second, _ in batch for s in (first, second)])
        with self.autocast():
            out = networks.features(tensors["crop"], tensors["object"])
        mean, covariance = vote_apart(out, 2)
        mean, covariance = mean.reshape(count, 2, 9, 2), covariance.reshape(count, 2, 9, 2, 2)
        index = tensors["object"][::2]
        T_true = tensors["T_cam_obj"][::2]
        T_second_ref = np.stack([T for _, _, T in batch])
        K = tensors["K"].reshape(count, 2, 3, 3)
        K = torch.from_numpy(grid_matrix(networks.features.config.stride)).float() @ K
        projection = _projections(K, T_second_ref)
        truth = self.keypoints[index] @ T_true[:, :3, :3].transpose(1, 2) + T_true[:, None, :3, 3]
        self._agree(mean, covariance, projection, truth, index)
        diameter = self.diameters[index]
        rngs = [generator_of(first, self.seed) if rng is None else rng for first, _, _ in batch]
        noise = torch.from_numpy(np.stack([own.normal(0, 0.1, 3) for own in rngs])).float()
        guess = truth[:, -1] + noise * diameter[:, None]
        if any(pose_noise):
            told = [perturb(T, *pose_noise, r) for T, r in zip(T_second_ref, rngs, strict=True)]
            projection = _projections(K, np.stack(told))
        side = out.volume.shape[-1]
        maps = ViewMaps(
            features=out.volume.reshape(count, 2, -1, side, side),
            projection=projection,
            vote_mean=mean,
            vote_covariance=covariance,
        )
        with self.autocast():
            levels = networks.volume(maps, guess, diameter)
        return {
            "levels": levels, "truth": truth, "T_true": T_true, "diameter": diameter,
            "index": index,
        }  # fmt: skip

    def solve(self, level: LevelOutput, out: dict[str, Any]) -> RigidMotions:
        """The poses that a level's keypoints mean, differentiably."""
        return solve(self.keypoints[out["index"]], level.keypoints.float(), out["diameter"])

    def _agree(
        self, mean: Tensor, covariance: Tensor, projection: Tensor, truth: Tensor, index: Tensor
    ) -> None:
        """Renumbers votes on symmetric objects to the pose that is trained, in place."""
        for sample, number in enumerate(index.tolist()):
            permutations = self.permutations[number]
            if len(permutations) == 1:
                continue
            for view in range(mean.shape[1]):
                P = projection[sample, view]
                uvw = truth[sample] @ P[:, :3].T + P[:, 3]
                pixels = uvw[:, :2] / uvw[:, 2:]
                errors = [
                    float((mean[sample, view, p] - pixels).norm(dim=-1).clamp(max=8.0).sum())
                    for p in permutations
                ]
                best = torch.from_numpy(permutations[int(np.argmin(errors))])
                mean[sample, view] = mean[sample, view, best].clone()
                covariance[sample, view] = covariance[sample, view, best].clone()

    def loss(self, batch: list[_Pair]) -> tuple[Tensor, dict[str, Tensor]]:
        self.networks.volume.train()
        out = self.forward(batch, pose_noise=self.pose_noise)
        total = torch.zeros(())
        numbers: dict[str, Tensor] = {}
        for level, name in zip(out["levels"], ("coarse", "fine"), strict=True):
            distribution = distribution_loss(
                level.log_probability, level.cells, out["truth"], level.cell_size
            )
            distance = keypoint_loss(level.keypoints, out["truth"], out["diameter"])
            total = total + _DISTRIBUTION_WEIGHT * distribution + _KEYPOINT_WEIGHT * distance
            numbers |= {
                f"{name}_kl": distribution,
                f"{name}_distance": distance,
            }
            if self.pose_weight and (name == "fine" or self.networks.volume.config.coarse_pose):
                solution = self.solve(level, out)
                pose = pose_loss(
                    solution.rotation, solution.translation, out["T_true"], out["diameter"],
                    alpha=0.3,
                )  # fmt: skip
                total = total + self.pose_weight * pose
                numbers["pose" if name == "fine" else "coarse_pose"] = pose
        return total, numbers

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """3D keypoint distance over the diameter, and ADD(-S) recall, guess with noise."""
        self.networks.volume.eval()
        rng = np.random.default_rng(1)
        errors: list[np.ndarray] = []
        hits: list[bool] = []
        # Volumes with voxels of a fixed size are a hundred times as large as others.
        rounds, size = (16, 16) if self.networks.volume.config.fine.cells else (24, 2)
        for _ in range(rounds):
            batch = [self.held_out.draw_pair(rng) for _ in range(size)]
            out = self.forward(batch, rng)
            solution = self.solve(out["levels"][-1], out)
            distance = (out["levels"][-1].keypoints - out["truth"]).norm(dim=-1).mean(1)
            errors.append((distance / out["diameter"]).numpy())
            hits += correct_poses(solution, out["index"], out["T_true"], self.held_out.models)
        return {
            "keypoint_over_diameter": float(np.mean(np.concatenate(errors))),
            "add_recall": float(np.mean(hits)),
        }


def perturb(
    T_second_ref: np.ndarray, degrees: float, metres: float, rng: np.random.Generator
) -> np.ndarray:
    """A relative pose (4, 4) as an inexact calibration would tell it.

    The second camera's frame is turned about a random axis through its centre by an angle that is
    even from 0 to ``degrees``, and shifted in a random direction by a length even from 0 to
    ``metres``.
    """
    axis, direction = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(axis * np.radians(rng.uniform(0, degrees))).as_matrix()
    return make_transform(turn, direction * rng.uniform(0, metres)) @ T_second_ref


def _projections(K: Tensor, T_second_ref: np.ndarray) -> Tensor:
    """Projections (B, 2, 3, 4) of both views from K (B, 2, 3, 3) and T_second_ref (B, 4, 4)."""
    second = torch.from_numpy(T_second_ref).float()
    return K @ torch.stack([torch.eye(4).expand_as(second), second], 1)[:, :, :3]
