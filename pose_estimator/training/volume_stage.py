"""Training of ``mid``'s volume: pairs of crops, on frozen 2D features or end to end."""

from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.pose_noise import perturb_relative_pose
from ..networks.container import PoseNetworks
from ..networks.volume import LevelOutput, ViewMaps
from ..networks.voting import vote
from ..solvers.rigid import RigidMotions, solve
from ..symmetry import keypoint_permutations
from ..training_data.dataset import TrainingSet
from ..training_data.target_sample import as_input, pair_arrays
from .loader import Batch, Sample, SampleFunction
from .losses import distribution_loss, features_loss, keypoint_loss, pose_loss
from .stage_base import KeypointStage, Predictions, padded_stack

_KEYPOINT_WEIGHT = 4.0
_DISTRIBUTION_WEIGHT = 0.2
"""The paper's beta2 and beta3; beta1, the pose loss's, is an argument."""

_GUESS_NOISE = 0.1
"""Standard deviation of the guess of the center, in diameters."""


class VolumeStage(KeypointStage):
    """The volume on pairs of views; by default only the lifted map of the 2D network is trained.

    The loss is the paper's, the sum over the levels of beta1 pose + beta2 keypoint + beta3 KL
    divergence. The coarse level's pose is included only where the volume's configuration says so
    (the preset ``paper``).

    Args:
        args: of :class:`StageBase`.
        pose_noise: maximum error of the volume's relative pose in training, as rotation in degrees
            and translation in meters; see :func:`perturb_relative_pose`.
        pose_weight: weight of the pose loss; 0 turns it off.
        tune_features: train the 2D features too (what of them is not frozen before), with their
            own loss added.
        kwargs: of :class:`StageBase`.
    """

    name = part = "volume"

    def __init__(
        self,
        *args: Any,
        pose_noise: tuple[float, float] = (0.0, 0.0),
        pose_weight: float = 1.0,
        tune_features: bool = False,
        **kwargs: Any,
    ):
        networks: PoseNetworks = args[0]
        learned = [p for p in networks.features.parameters() if tune_features and p.requires_grad]
        super().__init__(*args, **kwargs)
        self.pose_noise = pose_noise
        self.pose_weight = pose_weight
        # Volumes with voxels of a fixed size are a hundred times as large as others.
        self.validation = (16, 16) if self.networks.volume.config.fine.cells else (24, 2)
        heads = self.networks.features.volume_heads.requires_grad_(True)
        self._module = torch.nn.ModuleDict({"volume": self.networks.volume, "heads": heads})
        self.tune_features = tune_features
        if tune_features:
            self._module = torch.nn.ModuleDict(
                {"volume": self.networks.volume, "features": self.networks.features}
            )
            for parameter in learned:
                parameter.requires_grad_(True)
        self.permutations = padded_stack(
            [keypoint_permutations(m.keypoints, m.symmetries) for m in self.train.models]
        ).to(self.device)

    @property
    def module(self) -> torch.nn.Module:
        return self._module

    def sample_function(self, source: TrainingSet) -> SampleFunction:
        noise = self.pose_noise if source is self.train else (0.0, 0.0)
        return partial(draw_noisy_pair, source, noise, self.tune_features)

    def forward(self, batch: Batch) -> dict[str, Any]:
        """Runs a batch of pairs of :func:`draw_noisy_pair`."""
        networks = self.networks
        networks.features.eval()
        index, T_true = batch["object"], batch["T_cam_obj"]
        count = len(index)
        with self.autocast():
            out = networks.features(as_input(batch["crop"]), index.repeat_interleave(2))
        mean, covariance, _ = (part.unflatten(0, (count, 2)) for part in vote(out))
        K = self.to_grid @ batch["K"]
        truth = self.place(T_true, index)
        mean, covariance = self.relabel_votes(
            mean, covariance, _projections(K, batch["T_second_ref"]), truth, index
        )
        diameter = self.diameters[index]
        guess = truth[:, -1] + batch["guess_error"] * diameter[:, None]
        maps = ViewMaps(
            features=out.volume.unflatten(0, (count, 2)),
            projection=_projections(K, batch["noisy_T_second_ref"]),
            vote_mean=mean,
            vote_covariance=covariance,
        )
        with self.autocast():
            levels = networks.volume(maps, guess, diameter)
        return {
            "levels": levels, "truth": truth, "T_true": T_true, "diameter": diameter,
            "index": index, "features": out,
        }  # fmt: skip

    def solve(self, level: LevelOutput, out: dict[str, Any]) -> RigidMotions:
        """Fits the poses to a level's keypoints, differentiably."""
        keypoints, solver = self.keypoints[out["index"]], self.networks.volume.config.solver
        return solve(keypoints, level.keypoints.float(), out["diameter"], solver)

    def relabel_votes(
        self, mean: Tensor, covariance: Tensor, projection: Tensor, truth: Tensor, index: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Permutes votes on symmetric objects to match the ground-truth pose.

        Args:
            mean: (B, V, 9, 2) of the votes.
            covariance: (B, V, 9, 2, 2).
            projection: (B, V, 3, 4).
            truth: (B, 9, 3) keypoints in the ground-truth pose.
            index: (B,) object indices.

        Returns:
            The permuted mean and covariance.
        """
        uvw = truth[:, None] @ projection[..., :3].mT + projection[..., None, :, 3]
        pixels = uvw[..., :2] / uvw[..., 2:]
        permutations = self.permutations[index]  # (B, P, 9)
        samples = torch.arange(len(index), device=index.device)
        permuted = mean.transpose(1, 2)[samples[:, None, None], permutations]  # (B, P, 9, V, 2)
        error = (permuted - pixels.transpose(1, 2)[:, None]).norm(dim=-1).clamp(max=8.0)
        best = permutations[samples[:, None], error.sum(2).argmin(1)]  # (B, V, 9)
        places = samples[:, None, None], torch.arange(mean.shape[1], device=index.device)[:, None]
        return mean[*places, best], covariance[*places, best]

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self.networks.volume.train()
        out = self.forward(batch)
        total = torch.zeros((), device=self.device)
        terms: dict[str, Tensor] = {}
        for level, name in zip(out["levels"], ("coarse", "fine"), strict=True):
            distribution = distribution_loss(
                level.log_probability, level.cells, out["truth"], level.cell_size,
                predicted_first=self.networks.volume.config.predicted_first,
            )  # fmt: skip
            distance = keypoint_loss(level.keypoints, out["truth"], out["diameter"])
            total = total + _DISTRIBUTION_WEIGHT * distribution + _KEYPOINT_WEIGHT * distance
            terms |= {f"{name}_kl": distribution, f"{name}_distance": distance}
            if self.pose_weight and (name == "fine" or self.networks.volume.config.coarse_pose):
                pose = pose_loss(*self.solve(level, out), out["T_true"], out["diameter"])
                total = total + self.pose_weight * pose
                terms["pose" if name == "fine" else "coarse_pose"] = pose
        if self.tune_features:
            targets = (batch[name].flatten(0, 1) for name in ("mask", "directions"))
            loss, parts = features_loss(out["features"], *targets)
            total, terms = total + loss, terms | parts
        return total, terms

    def predict(self, batch: Batch) -> Predictions:
        out = self.forward(batch)
        level = out["levels"][-1]
        motions = self.solve(level, out)
        return Predictions(level.keypoints, motions, out["truth"], out["T_true"], out["index"])


def draw_noisy_pair(
    source: TrainingSet,
    pose_noise: tuple[float, float],
    with_fields: bool,
    rng: np.random.Generator,
) -> Sample:
    """Draws a pair, the error of its guessed center, and its relative pose with noise.

    Args:
        source: of the pair.
        pose_noise: maximum error of the relative pose in degrees and meters.
        with_fields: whether both views' masks and vector fields are in the sample.
        rng: random generator.
    """
    first, second, T_second_ref = source.draw_pair(rng, with_depth=False)
    guess_error = rng.normal(0, _GUESS_NOISE, 3)
    noisy = T_second_ref
    if any(pose_noise):
        noisy = perturb_relative_pose(T_second_ref, *pose_noise, rng, uniform=True)
    fields = ("mask", "directions") if with_fields else ()
    return {
        **pair_arrays(first, second),
        **{name: np.stack([getattr(v, name) for v in (first, second)]) for name in fields},
        "T_second_ref": T_second_ref.astype(np.float32),
        "noisy_T_second_ref": noisy.astype(np.float32),
        "guess_error": guess_error.astype(np.float32),
    }


def _projections(K: Tensor, T_second_ref: Tensor) -> Tensor:
    """Projections (B, 2, 3, 4) of both views from K (B, 2, 3, 3) and T_second_ref (B, 4, 4)."""
    identity = torch.eye(4, device=K.device).expand_as(T_second_ref)
    return K @ torch.stack([identity, T_second_ref], 1)[:, :, :3]
