"""Training of ``rgbd``'s points: single crops with depth, on frozen 2D features."""

from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..networks.point_cloud import MIN_POINTS, sample_points
from ..networks.point_voting import PointMaps, PointVotes, point_features
from ..networks.voting import vote
from ..solvers.rigid import RigidMotions, solve
from ..training_data.dataset import TrainingSet
from ..training_data.depth_augmentation import DepthAugmentationConfig, augment_depth
from ..training_data.target_sample import as_input, target_arrays
from .loader import Batch, Sample, SampleFunction
from .losses import keypoint_loss, pose_loss
from .stage_base import KeypointStage, Predictions, padded_stack


class PointStage(KeypointStage):
    """Points that vote for keypoints."""

    name = part = "points"
    needs_depth = True

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        symmetries = padded_stack([m.symmetries for m in self.train.models])
        self.symmetries = symmetries.float().to(self.device)

    def sample_function(self, source: TrainingSet) -> SampleFunction:
        return partial(draw_with_sensor_noise, source)

    def forward(self, batch: Batch) -> dict[str, Any]:
        """Runs a batch of crops; ``valid`` (B,) marks those with enough points."""
        networks = self.networks
        networks.features.eval()
        index, K = batch["object"], batch["K"]
        diameter = self.diameters[index]
        with torch.no_grad(), self.autocast():
            out = networks.features(as_input(batch["crop"]), index)
        mean, covariance, _ = vote(out)
        mask = torch.sigmoid(out.mask_logits.float())
        features = point_features(out.decoder, mask)
        maps = PointMaps(features, mean, covariance, self.to_grid @ K)
        # One generator per crop, so that its draws do not depend on the batch.
        draws = [torch.Generator("cpu").manual_seed(n) for n in batch["points_seed"].tolist()]
        cloud = sample_points(
            batch["depth"], mask, K, diameter, networks.points.config.points, draws
        )
        votes = networks.points(maps, cloud, index, diameter)
        T_true = self.nearest_equivalent(votes.keypoints, batch["T_cam_obj"], index)
        return {
            "votes": votes, "cloud": cloud, "truth": self.place(T_true, index), "T_true": T_true,
            "index": index, "diameter": diameter, "valid": cloud.valid.sum(1) >= MIN_POINTS,
            "solution": solve(self.keypoints[index], votes.keypoints, diameter),
        }  # fmt: skip

    def nearest_equivalent(self, keypoints: Tensor, T_cam_obj: Tensor, index: Tensor) -> Tensor:
        """Returns the symmetry-equivalent poses (B, 4, 4) nearest to keypoints (B, 9, 3).

        All points of a cloud vote for the same equivalent; the network is free to choose which.
        """
        poses = T_cam_obj[:, None] @ self.symmetries[index]
        placed = self.place(poses, index[:, None].expand(poses.shape[:2]))
        distance = (placed - keypoints.detach()[:, None]).norm(dim=-1).sum(-1)
        return poses[torch.arange(len(index), device=index.device), distance.argmin(1)]

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self.networks.points.train()
        out = self.forward(batch)
        keep, votes, solution = out["valid"], out["votes"], out["solution"]
        if not keep.any():
            nothing = 0 * (votes.candidates.sum() + votes.log_error.sum())
            return nothing, dict.fromkeys(("offset", "confidence", "distance", "pose"), nothing)
        diameter, T_true, truth = (out[name][keep] for name in ("diameter", "T_true", "truth"))
        offset, confidence = vote_losses(
            PointVotes(*(part[keep] for part in votes)),
            truth @ out["cloud"].R_crop_cam[keep].mT,
            out["cloud"].valid[keep],
            diameter,
        )
        distance = keypoint_loss(votes.keypoints[keep], truth, diameter)
        pose = pose_loss(solution.rotation[keep], solution.translation[keep], T_true, diameter)
        total = 2.0 * offset + 0.2 * confidence + 4.0 * distance + pose
        return total, {
            "offset": offset, "confidence": confidence, "distance": distance, "pose": pose,
        }  # fmt: skip

    def predict(self, batch: Batch) -> Predictions:
        out = self.forward(batch)
        keep = out["valid"]
        parts = (out["votes"].keypoints, out["truth"], out["T_true"], out["index"])
        keypoints, truth, T_true, index = (part[keep] for part in parts)
        motions = RigidMotions(*(part[keep] for part in out["solution"]))
        return Predictions(keypoints, motions, truth, T_true, index)


def draw_with_sensor_noise(source: TrainingSet, rng: np.random.Generator) -> Sample:
    """Draws a target, its depth with sensor noise, and a seed for sampling its points."""
    sample = source.draw_target(rng)
    assert sample.depth is not None
    arrays = target_arrays(sample)
    del arrays["mask"], arrays["directions"]
    depth = augment_depth(sample.depth, DepthAugmentationConfig(), rng)
    return {**arrays, "depth": depth, "points_seed": int(rng.integers(2**31))}


def vote_losses(
    votes: PointVotes, truth: Tensor, valid: Tensor, diameter: Tensor
) -> tuple[Tensor, Tensor]:
    """Returns the losses of the votes and of their predicted errors.

    Args:
        votes: of B crops.
        truth: (B, 9, 3) keypoints in the crops' frames, m.
        valid: (B, N) which points vote.
        diameter: (B,) m.

    Returns:
        The mean error of a vote in diameters, and the negative log-likelihood of the errors under
        Laplace distributions of the predicted widths: DenseFusion's confidence loss (Wang et al.,
        CVPR 2019, equation 2) with the inverse width as confidence. The second has no gradient with
        respect to the votes.
    """
    error = (votes.candidates - truth[:, None]).norm(dim=-1) / diameter[:, None, None]
    likelihood = error.detach() * torch.exp(-votes.log_error) + votes.log_error
    weight = valid[..., None] / valid.sum(1).clamp(min=1)[:, None, None]
    return (weight * error).sum(1).mean(), (weight * likelihood).sum(1).mean()
