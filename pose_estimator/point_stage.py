"""The training of ``rgbd``'s points: single crops with depth, on top of frozen 2D features."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .data_parallel import quotient
from .depth_augmentation import DepthAugmentationConfig, augment_depth
from .geometry import grid_matrix
from .loader import batches
from .losses import keypoint_loss, pose_loss
from .point_cloud import LEAST_POINTS, sample_points
from .point_voting import PointMaps, PointVotes, point_features
from .solvers import RigidMotions, solve
from .stages import StageBase, correct_poses, vote_apart
from .target_sample import TargetSample, generator_of, stack_targets

_HELD_OUT_BATCHES = 10
"""Batches of 32 crops that a validation takes."""


class PointStage(StageBase):
    """Points that vote for keypoints; the 2D network stays as it is.

    Training needs a dataset with depth maps; see :meth:`batches`.
    """

    name = "points"

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.networks.features.requires_grad_(False)
        models = self.train.models
        self.keypoints = torch.from_numpy(np.stack([m.keypoints for m in models])).float()
        self.diameters = torch.tensor([m.diameter for m in models], dtype=torch.float32)
        self.symmetries = [torch.from_numpy(m.symmetries).float() for m in models]

    @property
    def module(self) -> torch.nn.Module:
        return self.networks.points

    def batches(self, start: int) -> Iterator[list[TargetSample]]:
        """Endless batches from number ``start`` on.

        Raises:
            ValueError: if the dataset has no depth maps.
        """
        if self.train.pack.depth(int(self.train.targets[0])) is None:
            raise ValueError(
                "the stage points needs depth maps, and the dataset has none: make one with "
                "python -m two_view_pose generate --depth"
            )
        return batches(lambda rng: noisy(self.train, rng), self.batch, self.seed, start)

    def forward(
        self, batch: list[TargetSample], rng: np.random.Generator | None = None
    ) -> dict[str, Any]:
        """Runs a batch. Crops with too few points are not ``enough``.

        Args:
            batch: the crops.
            rng: chooses the points; None = each crop has its own, wherever in a batch it stands.
        """
        networks = self.networks
        networks.features.eval()
        tensors = stack_targets(batch)
        depth = torch.from_numpy(np.stack([s.depth for s in batch if s.depth is not None]))
        index = tensors["object"]
        diameter = self.diameters[index]
        with torch.no_grad(), self.autocast():
            out = networks.features(tensors["crop"], index)
        mean, covariance = vote_apart(out, 1)
        to_grid = torch.from_numpy(grid_matrix(networks.features.config.stride)).float()
        mask = torch.sigmoid(out.mask_logits.float())
        features = point_features(out.decoder, mask)
        maps = PointMaps(features, mean, covariance, to_grid @ tensors["K"])
        rngs = [generator_of(s, self.seed) if rng is None else rng for s in batch]
        generators = [torch.Generator().manual_seed(int(own.integers(2**31))) for own in rngs]
        cloud = sample_points(
            depth,
            mask,
            tensors["K"],
            diameter,
            networks.points.config.points,
            generators,
        )
        enough = cloud.valid.sum(1) >= LEAST_POINTS
        votes = networks.points(maps, cloud, index, diameter)
        T_true = self.nearest_equivalent(votes.keypoints, tensors["T_cam_obj"], index)
        truth = self._place(T_true, index)
        return {
            "votes": votes, "cloud": cloud, "truth": truth, "T_true": T_true, "index": index,
            "diameter": diameter, "enough": enough,
            "solution": solve(self.keypoints[index], votes.keypoints, diameter),
        }  # fmt: skip

    def nearest_equivalent(self, keypoints: Tensor, T_cam_obj: Tensor, index: Tensor) -> Tensor:
        """The equivalent poses (B, 4, 4) of symmetric objects that keypoints (B, 9, 3) mean.

        All points of a cloud must mean the same pose; which of the equivalents it is, is theirs to
        choose.
        """
        chosen = T_cam_obj.clone()
        for sample, number in enumerate(index.tolist()):
            symmetries = self.symmetries[number]
            if len(symmetries) > 1:
                poses = T_cam_obj[sample] @ symmetries
                placed = self._place(poses, index[sample].expand(len(poses)))
                distance = (placed - keypoints[sample].detach()).norm(dim=-1).sum(-1)
                chosen[sample] = poses[int(distance.argmin())]
        return chosen

    def _place(self, T_cam_obj: Tensor, index: Tensor) -> Tensor:
        """Keypoints (B, 9, 3) of objects in poses (B, 4, 4)."""
        return self.keypoints[index] @ T_cam_obj[:, :3, :3].mT + T_cam_obj[:, None, :3, 3]

    def loss(self, batch: list[TargetSample]) -> tuple[Tensor, dict[str, Tensor]]:
        self.networks.points.train()
        out = self.forward(batch)
        keep, votes, solution = out["enough"], out["votes"], out["solution"]
        # Of all crops that are kept, in whatever process, each counts the same.
        share = quotient(keep.sum(), keep.sum())
        if not keep.any():
            nothing = 0 * (votes.candidates.sum() + votes.log_error.sum())
            return nothing, dict.fromkeys(("offset", "sure", "distance", "pose"), nothing)
        diameter, T_true, truth = (out[name][keep] for name in ("diameter", "T_true", "truth"))
        offset, sure = vote_losses(
            PointVotes(*(part[keep] for part in votes)),
            truth @ out["cloud"].R_crop_cam[keep].mT,
            out["cloud"].valid[keep],
            diameter,
        )
        distance = keypoint_loss(votes.keypoints[keep], truth, diameter)
        pose = pose_loss(
            solution.rotation[keep], solution.translation[keep], T_true, diameter, alpha=0.3
        )
        total = 2.0 * offset + 0.2 * sure + 4.0 * distance + pose
        numbers = {"offset": offset, "sure": sure, "distance": distance, "pose": pose}
        return share * total, {name: share * part for name, part in numbers.items()}

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """3D keypoint distance over the diameter, and ADD(-S) recall, on noisy depth."""
        self.networks.points.eval()
        rng = np.random.default_rng(1)
        errors: list[np.ndarray] = []
        hits: list[bool] = []
        for _ in range(_HELD_OUT_BATCHES):
            batch = [noisy(self.held_out, rng) for _ in range(32)]
            out = self.forward(batch, rng)
            distance = (out["votes"].keypoints - out["truth"]).norm(dim=-1).mean(1)
            errors.append((distance / out["diameter"])[out["enough"]].numpy())
            keep = out["enough"]
            motions = RigidMotions(*(part[keep] for part in out["solution"]))
            hits += correct_poses(
                motions, out["index"][keep], out["T_true"][keep], self.held_out.models
            )
        return {
            "keypoint_over_diameter": float(np.mean(np.concatenate(errors))),
            "add_recall": float(np.mean(hits)),
        }


def noisy(source: Any, rng: np.random.Generator) -> TargetSample:
    """A random target, its depth spoilt as a sensor would."""
    sample = source.draw_target(rng)
    depth = augment_depth(sample.depth, DepthAugmentationConfig(), rng)
    return replace(sample, depth=depth)


def vote_losses(
    votes: PointVotes, truth: Tensor, valid: Tensor, diameter: Tensor
) -> tuple[Tensor, Tensor]:
    """How far the votes are off, and how well they know it.

    Args:
        votes: of B crops.
        truth: (B, 9, 3) keypoints in the crops' frames, m.
        valid: (B, N) which points vote.
        diameter: (B,) m.

    Returns:
        The mean error of a vote in diameters, and the negative log-likelihood of the errors under
        Laplace distributions of the widths that the votes say. The latter is DenseFusion's
        confidence loss (Wang et al., CVPR 2019, equation 2), with the inverse width as confidence;
        it does not move the votes themselves.
    """
    miss = (votes.candidates - truth[:, None]).norm(dim=-1) / diameter[:, None, None]
    likelihood = miss.detach() * torch.exp(-votes.log_error) + votes.log_error
    weight = valid[..., None] / valid.sum(1).clamp(min=1)[:, None, None]
    return (weight * miss).sum(1).mean(), (weight * likelihood).sum(1).mean()
