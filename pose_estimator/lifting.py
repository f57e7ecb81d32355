"""What a voxel knows: features and votes of every view where it projects to, and the joint pose.

Evidence is a log-likelihood up to a constant. A view's votes say how likely each voxel is to be a
keypoint as far as one view can tell: they know rays. The pose that explains the votes of all views
at once knows the object's shape, and so how far away it is also where the views stand too close
together for their rays to say.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from .pnp import PnpResult, keypoints_covariance

_EVIDENCE_FLOOR = 1e-3
"""What a voxel far from a vote keeps of its probability: a vote may be wrong."""

_VOXEL_DEVIATION = 0.4
"""Standard deviation in voxels that a voxel's extent adds to a vote."""

_INFLATION = 4.0
"""By how much the covariance of a joint pose is too small: votes do not err independently."""

_LEAST_DEVIATION = 0.02
"""Standard deviation in diameters that a joint pose's keypoints have at least."""


class ViewMaps(NamedTuple):
    """What B samples of V views bring to a volume, the reference view first.

    Attributes:
        features: (B, V, C, G, G).
        projection: (B, V, 3, 4), from the reference camera's frame to pixels of the feature grid.
        vote_mean: (B, V, 9, 2), pixels of the feature grid.
        vote_covariance: (B, V, 9, 2, 2).
    """

    features: Tensor
    projection: Tensor
    vote_mean: Tensor
    vote_covariance: Tensor


class KeypointPrior(NamedTuple):
    """Where the pose that explains all votes puts the keypoints of B samples.

    Attributes:
        mean: (B, 9, 3) in the reference camera's frame, m.
        covariance: (B, 9, 3, 3) that follows from the pose's, m^2.
    """

    mean: Tensor
    covariance: Tensor

    @classmethod
    def from_poses(
        cls, poses: Sequence[PnpResult], keypoints: Sequence[np.ndarray]
    ) -> KeypointPrior:
        """From poses in the reference camera and the keypoints (9, 3) of their objects."""
        mean, covariance = [], []
        for pose, points in zip(poses, keypoints, strict=True):
            T = pose.T_cam_obj
            mean.append(points @ T[:3, :3].T + T[:3, 3])
            covariance.append(keypoints_covariance(T, points, pose.covariance))
        return cls(
            torch.from_numpy(np.stack(mean)).float(), torch.from_numpy(np.stack(covariance)).float()
        )


def voxel_centres(centre: Tensor, half: Tensor, count: int) -> Tensor:
    """Centres (B, count^3, 3) of the voxels of cubes of half side ``half`` (B,) around (B, 3)."""
    steps = (torch.arange(count, dtype=centre.dtype) + 0.5) / count * 2 - 1
    grid = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    return centre[:, None] + grid * half[:, None, None]


def lift(
    views: ViewMaps, cells: Tensor, cell_size: Tensor, outside: Tensor, with_evidence: bool
) -> tuple[Tensor, Tensor | None]:
    """Samples every view at the projections of voxels.

    Args:
        views: what the views bring.
        cells: (B, N, 3) in the reference camera's frame, m.
        cell_size: (B,) side of a voxel, m.
        outside: (C,) what a voxel gets that projects outside a view.
        with_evidence: whether to lift the votes as well.

    Returns:
        Features (B, V, C, N) and evidence (B, V, 9, N) or None: log-likelihoods up to a constant.
    """
    batch, count, channels, side, _ = views.features.shape
    P = views.projection
    uvw = torch.einsum("bvij,bnj->bvni", P[..., :3], cells) + P[..., 3].unsqueeze(2)
    pixels = uvw[..., :2] / uvw[..., 2:].clamp(min=0.05)
    grid = pixels * (2.0 / (side - 1)) - 1.0
    features = views.features.float()  # sampling positions do not bear bfloat16
    sampled = F.grid_sample(
        features.reshape(batch * count, channels, side, side),
        grid.reshape(batch * count, 1, -1, 2),
        mode="bilinear",
        padding_mode="border",
        align_corners=True,
    ).reshape(batch, count, channels, -1)
    inside = (grid.abs().amax(-1) <= 1.0) & (uvw[..., 2] > 0.05)
    sampled = torch.where(
        inside.unsqueeze(2), sampled, outside.to(sampled.dtype)[None, None, :, None]
    )
    if not with_evidence:
        return sampled, None
    covariance = views.vote_covariance + _footprint(P, cells.mean(1), cell_size).unsqueeze(2)
    precision = torch.linalg.inv(covariance)
    offset = pixels.unsqueeze(2) - views.vote_mean.unsqueeze(3)
    x, y = offset[..., 0], offset[..., 1]
    distance = (
        precision[..., 0, 0, None] * x * x
        + 2 * precision[..., 0, 1, None] * x * y
        + precision[..., 1, 1, None] * y * y
    )
    evidence = torch.log(torch.exp(-0.5 * distance) + _EVIDENCE_FLOOR)
    return sampled, evidence.to(sampled.dtype)


def _footprint(projection: Tensor, centre: Tensor, cell_size: Tensor) -> Tensor:
    """Covariance (B, V, 2, 2) of a voxel's projection, for voxels near ``centre`` (B, 3).

    A vote sharper than a voxel would fall between the centres of voxels and be lost.
    """
    uvw = torch.einsum("bvij,bj->bvi", projection[..., :3], centre) + projection[..., 3]
    depth = uvw[..., 2:].clamp(min=0.05)
    pixel = uvw[..., :2] / depth
    rows = projection[..., :2, :3] - pixel.unsqueeze(-1) * projection[..., 2:, :3]
    jacobian = rows * (_VOXEL_DEVIATION * cell_size[:, None, None] / depth).unsqueeze(-1)
    return jacobian @ jacobian.transpose(-1, -2)


def prior_evidence(
    prior: KeypointPrior, cells: Tensor, cell_size: Tensor, diameter: Tensor
) -> Tensor:
    """How likely the joint pose makes each voxel to be each keypoint.

    Args:
        prior: the keypoints of the joint pose.
        cells: (B, N, 3) in the reference camera's frame, m.
        cell_size: (B,) side of a voxel, m.
        diameter: (B,) m.

    Returns:
        (B, 9, N) log-likelihoods up to a constant.
    """
    least = (_VOXEL_DEVIATION * cell_size) ** 2 + (_LEAST_DEVIATION * diameter) ** 2
    eye = torch.eye(3, dtype=cells.dtype, device=cells.device)
    covariance = _INFLATION * prior.covariance + least[:, None, None, None] * eye
    precision = torch.linalg.inv(covariance)
    offset = cells[:, None] - prior.mean[:, :, None]
    distance = ((offset @ precision) * offset).sum(-1)
    return torch.log(torch.exp(-0.5 * distance) + _EVIDENCE_FLOOR)
