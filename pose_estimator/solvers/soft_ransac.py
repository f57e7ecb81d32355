"""Soft RANSAC, the paper's solver: a pose from nine 3D keypoints, differentiable and robust.

Each triple of keypoints gives a rigid hypothesis, C(9, 3) = 84 in all. A hypothesis is scored by
its soft number of inliers,

    s_k = sum_i sigmoid(gamma1 * (gamma2 - d_ki)),    d_ki = |R_k m_i + t_k - p_i|,

and the hypotheses are averaged with weights proportional to their scores. The mean of the rotations
is projected onto SO(3).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ...core.errors import InputError
from .so3 import project_to_so3
from .three_point import three_point_fits


@dataclass(frozen=True)
class SoftRansacConfig:
    """How hypotheses are scored.

    Attributes:
        gamma1: steepness of the inlier test in 1/m, one number or one for each pose (B,).
        gamma2: distance in meters at which a keypoint counts half, one number or (B,).
        sharpness: hypotheses are weighted by ``score ** sharpness``. The paper uses 1; about
            8 is robust to gross outliers.
    """

    gamma1: float | torch.Tensor = 500.0
    gamma2: float | torch.Tensor = 0.01
    sharpness: float = 1.0

    @classmethod
    def for_diameter(
        cls, diameter: float | torch.Tensor, *, inlier: float = 0.1, sharpness: float = 1.0
    ) -> SoftRansacConfig:
        """Scales the inlier test by the object's diameter in meters; ``inlier`` is in diameters."""
        gamma2 = inlier * diameter
        return cls(gamma1=5.0 / gamma2, gamma2=gamma2, sharpness=sharpness)


@dataclass(frozen=True, eq=False)
class SoftRansacResult:
    """Poses and the hypotheses behind them.

    Attributes:
        rotation: (B, 3, 3).
        translation: (B, 3), meters.
        weights: (B, C(K, 3)), of the hypotheses in the order of ``itertools.combinations``; they
            sum to one.
    """

    rotation: torch.Tensor
    translation: torch.Tensor
    weights: torch.Tensor


def soft_ransac(
    model_points: torch.Tensor,
    predicted: torch.Tensor,
    config: SoftRansacConfig = SoftRansacConfig(),
) -> SoftRansacResult:
    """Averages all three-point poses, weighted by their soft inlier counts.

    Gradients flow to ``predicted``; the model is constant. Work is done in float32
    (float64 for float64 input), also under autocast.

    Args:
        model_points: keypoints in the object's frame, (K, 3) or (B, K, 3), meters.
        predicted: the same keypoints in the camera's frame, (B, K, 3), meters.
        config: scoring; the paper's by default.

    Raises:
        InputError: if shapes do not match, or all keypoints of a model lie on one line.
    """
    model_points, predicted = check_points(model_points, predicted)
    with torch.autocast(predicted.device.type, enabled=False):
        hypotheses = three_point_fits(model_points, predicted)
        gamma1, gamma2 = (
            gamma.to(predicted).reshape(-1, 1, 1) if isinstance(gamma, torch.Tensor) else gamma
            for gamma in (config.gamma1, config.gamma2)
        )
        # s_k = sum_i sigmoid(gamma1 * (gamma2 - d_ki)).
        inliers = (gamma1 * (gamma2 - hypotheses.residuals())).sigmoid()
        scores = inliers.sum(dim=1)

        # softmax(p log s) = s^p / sum s^p. A pose with degenerate triples only is still finite.
        powers = config.sharpness * (scores + 1e-12).log()
        alpha = powers.masked_fill(hypotheses.degenerate, -1e4).softmax(dim=-1)
        # The rotation is about the model's centroid, which moves to the mean of its positions.
        mean_rotation, position = hypotheses.average(alpha)
        rotation = project_to_so3(mean_rotation)
        translation = position - (rotation @ hypotheses.triangles.center[..., None])[..., 0]
    return SoftRansacResult(rotation, translation, alpha)


def kabsch(
    model_points: torch.Tensor, predicted: torch.Tensor, weights: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Least-squares rigid motion of all points (Kabsch 1976), differentiable.

    Takes what :func:`soft_ransac` does; ``weights`` (B, K) are those of the squared distances.

    Returns:
        Rotation (B, 3, 3) and translation (B, 3), model to predicted.

    Raises:
        InputError: if shapes do not match.
    """
    model_points, predicted = check_points(model_points, predicted)
    with torch.autocast(predicted.device.type, enabled=False):
        if weights is None:
            weights = predicted.new_ones(predicted.shape[:2])
        weights = weights.to(predicted.dtype)
        shares = (weights / weights.sum(dim=-1, keepdim=True).clamp_min(1e-12))[..., None]
        model_centroid = (shares * model_points).sum(dim=-2)
        centroid = (shares * predicted).sum(dim=-2)
        covariance = (shares * (predicted - centroid[:, None])).transpose(1, 2) @ (
            model_points - model_centroid[:, None]
        )
        rotation = project_to_so3(covariance)
        translation = centroid - (rotation @ model_centroid[..., None])[..., 0]
    return rotation, translation


def check_points(
    model_points: torch.Tensor, predicted: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Checks the shapes; returns both in one dtype that torch.linalg supports."""
    if predicted.ndim != 3 or predicted.shape[-1] != 3 or predicted.shape[1] < 3:
        raise InputError(
            f"predicted must be (B, K, 3) with K >= 3, got shape {tuple(predicted.shape)}"
        )
    if model_points.shape not in (predicted.shape, predicted.shape[1:]):
        raise InputError(
            f"model_points must be {tuple(predicted.shape[1:])} or {tuple(predicted.shape)} to "
            f"match predicted, got shape {tuple(model_points.shape)}"
        )
    dtype = torch.float64 if predicted.dtype == torch.float64 else torch.float32
    return model_points.detach().to(predicted.device, dtype), predicted.to(dtype)
