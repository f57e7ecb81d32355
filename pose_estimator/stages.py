"""The three trainings: the detector, the 2D features, and the volume on top of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .dataset import TargetSample, TrainingSet, batches, stack_targets
from .detector import decode
from .frontend import grid_matrix, vote
from .losses import (
    box_loss,
    direction_loss,
    distribution_loss,
    heat_map_loss,
    keypoint_loss,
    mask_loss,
    pose_loss,
)
from .mid_fusion import SOLVER_INLIER, SOLVER_SHARPNESS
from .networks import PoseNetworks, has_fast_bfloat16
from .soft_ransac import SoftRansacConfig, soft_ransac
from .symmetry import keypoint_permutations
from .volume import ViewMaps

_Frame = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
_Pair = tuple[TargetSample, TargetSample, np.ndarray]


class _StageBase:
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
        self.bfloat16 = has_fast_bfloat16()

    def autocast(self) -> torch.autocast:
        return torch.autocast("cpu", torch.bfloat16, enabled=self.bfloat16)


class DetectorStage(_StageBase):
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


class FeatureStage(_StageBase):
    """Segmentation and vector fields on single crops."""

    name = "features"

    @property
    def module(self) -> torch.nn.Module:
        return self.networks.features

    def batches(self, start: int) -> Iterator[list[TargetSample]]:
        return batches(self.train.draw_target, self.batch, self.seed, start)

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


class VolumeStage(_StageBase):
    """The volume on pairs of views; of the 2D network only the lifted map is trained with it."""

    name = "volume"

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.networks.features.requires_grad_(False)
        self.networks.features.volume_head.requires_grad_(True)
        self.module = torch.nn.ModuleDict(
            {"volume": self.networks.volume, "head": self.networks.features.volume_head}
        )
        models = self.train.models
        self.keypoints = torch.from_numpy(np.stack([m.keypoints for m in models])).float()
        self.diameters = torch.tensor([m.diameter for m in models], dtype=torch.float32)
        self.permutations = [keypoint_permutations(m.keypoints, m.symmetries) for m in models]

    def batches(self, start: int) -> Iterator[list[_Pair]]:
        return batches(self.train.draw_pair, self.batch, self.seed, start)

    def forward(self, batch: list[_Pair], rng: np.random.Generator) -> dict[str, Any]:
        """Runs a batch of pairs; the guess of the centre is the truth with noise."""
        networks = self.networks
        networks.features.eval()
        count = len(batch)
        tensors = stack_targets([s for first, second, _ in batch for s in (first, second)])
        with self.autocast():
            out = networks.features(tensors["crop"], tensors["object"])
        mean, covariance, _ = vote(out)
        mean, covariance = mean.reshape(count, 2, 9, 2), covariance.reshape(count, 2, 9, 2, 2)
        index = tensors["object"][::2]
        T_true = tensors["T_cam_obj"][::2]
        T_second_ref = torch.from_numpy(np.stack([T for _, _, T in batch])).float()
        K = tensors["K"].reshape(count, 2, 3, 3)
        K = torch.from_numpy(grid_matrix(networks.features.config.stride)).float() @ K
        extrinsics = torch.stack([torch.eye(4).expand(count, 4, 4), T_second_ref], 1)[:, :, :3]
        projection = K @ extrinsics
        truth = self.keypoints[index] @ T_true[:, :3, :3].transpose(1, 2) + T_true[:, None, :3, 3]
        self._agree(mean, covariance, projection, truth, index)
        diameter = self.diameters[index]
        noise = torch.from_numpy(rng.normal(0, 0.1, (count, 3))).float()
        guess = truth[:, -1] + noise * diameter[:, None]
        side = out.volume.shape[-1]
        maps = ViewMaps(
            features=out.volume.reshape(count, 2, -1, side, side),
            projection=projection,
            vote_mean=mean,
            vote_covariance=covariance,
        )
        with self.autocast():
            levels = networks.volume(maps, guess, diameter)
        solver = SoftRansacConfig.for_diameter(
            diameter, inlier=SOLVER_INLIER, sharpness=SOLVER_SHARPNESS
        )
        solution = soft_ransac(self.keypoints[index], levels[-1].keypoints.float(), solver)
        return {
            "levels": levels, "truth": truth, "T_true": T_true, "diameter": diameter,
            "solution": solution, "index": index,
        }  # fmt: skip

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
        rng = np.random.default_rng(
            [self.seed, *np.round(batch[0][2][:3, 3] * 1e6).astype(int) % 2**31]
        )
        out = self.forward(batch, rng)
        total = torch.zeros(())
        numbers: dict[str, Tensor] = {}
        for level, name in zip(out["levels"], ("coarse", "fine"), strict=True):
            distribution = distribution_loss(
                level.log_probability, level.cells, out["truth"], level.cell_size
            )
            distance = keypoint_loss(level.keypoints, out["truth"], out["diameter"])
            total = total + 0.2 * distribution + 4.0 * distance
            numbers |= {
                f"{name}_kl": distribution,
                f"{name}_distance": distance,
            }
        solution = out["solution"]
        pose = pose_loss(
            solution.rotation, solution.translation, out["T_true"], out["diameter"], alpha=0.3
        )
        numbers["pose"] = pose
        return total + pose, numbers

    @torch.no_grad()
    def validate(self) -> dict[str, float]:
        """3D keypoint distance over the diameter, and ADD(-S) recall, guess with noise."""
        self.networks.volume.eval()
        rng = np.random.default_rng(1)
        errors, hits = [], []
        for _ in range(16):
            batch = [self.held_out.draw_pair(rng) for _ in range(16)]
            out = self.forward(batch, rng)
            distance = (out["levels"][-1].keypoints - out["truth"]).norm(dim=-1).mean(1)
            errors.append((distance / out["diameter"]).numpy())
            for sample, number in enumerate(out["index"].tolist()):
                model = self.held_out.models[number]
                R = out["solution"].rotation[sample].numpy()
                t = out["solution"].translation[sample].numpy()
                T = out["T_true"][sample].numpy()
                moved = model.points @ R.T + t
                best = min(
                    np.linalg.norm(
                        moved - (model.points @ (T @ S)[:3, :3].T + (T @ S)[:3, 3]), axis=1
                    ).mean()
                    for S in model.symmetries
                )
                hits.append(best < 0.1 * model.diameter)
        return {
            "keypoint_over_diameter": float(np.mean(np.concatenate(errors))),
            "add_recall": float(np.mean(hits)),
        }
