"""Soft RANSAC: one pose from nine 3D keypoints, differentiably and in spite of outliers.

The solver of the paper. Every triple of keypoints gives one rigid hypothesis, C(9, 3) = 84 in all;
every hypothesis is scored by how many keypoints it brings near their predictions,

    s_k = sum_i sigmoid(gamma1 * (gamma2 - d_ki)),    d_ki = |R_k m_i + t_k - p_i|,

and the hypotheses are averaged in proportion to their scores. The average of rotations is projected
back onto SO(3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch.autograd.function import once_differentiable

from .three_point import misses, three_point_fits


@dataclass(frozen=True)
class SoftRansacConfig:
    """How hypotheses are scored.

    Attributes:
        gamma1: steepness of the inlier test in 1/m, one number or one for each pose (B,).
        gamma2: distance in metres at which a keypoint counts half, one number or (B,).
        sharpness: hypotheses are weighted by ``score ** sharpness``. The paper's average is 1; more
            leans towards the best hypotheses, and about 8 shakes off gross outliers.
    """

    gamma1: float | torch.Tensor = 500.0
    gamma2: float | torch.Tensor = 0.01
    sharpness: float = 1.0

    @classmethod
    def for_diameter(
        cls, diameter: float | torch.Tensor, *, inlier: float = 0.1, sharpness: float = 1.0
    ) -> SoftRansacConfig:
        """Scales the inlier test with the object.

        Args:
            diameter: of the object in metres, one number or one for each pose (B,).
            inlier: ``gamma2`` in diameters.
            sharpness: as the attribute.
        """
        gamma2 = inlier * diameter
        return cls(gamma1=5.0 / gamma2, gamma2=gamma2, sharpness=sharpness)


@dataclass(frozen=True, eq=False)
class SoftRansacResult:
    """Poses and the hypotheses behind them.

    Attributes:
        rotation: (B, 3, 3).
        translation: (B, 3), metres.
        weights: (B, C(K, 3)), of the hypotheses in the order of ``itertools.combinations``; they
            sum to one.
    """

    rotation: torch.Tensor
    translation: torch.Tensor
    weights: torch.Tensor


def soft_ransac(
    model_points: torch.Tensor,
    predicted: torch.Tensor,
    config: SoftRansacConfig | None = None,
    weights: torch.Tensor | None = None,
) -> SoftRansacResult:
    """Averages all three-point poses, each by its soft inlier count.

    Gradients flow to ``predicted`` and ``weights``; the model is constant. Work is done in float32
    (float64 for float64 input), also under autocast.

    Args:
        model_points: keypoints in the object's frame, (K, 3) or (B, K, 3), metres.
        predicted: the same keypoints in the camera's frame, (B, K, 3), metres.
        config: scoring; the paper's if None.
        weights: how much each keypoint counts in the scores, (B, K), not negative; 1 if None.

    Raises:
        ValueError: if shapes do not match, or all keypoints of a model lie on one line.
    """
    config = SoftRansacConfig() if config is None else config
    model_points, predicted = check_points(model_points, predicted)
    with torch.autocast(predicted.device.type, enabled=False):
        rotations, translations, flatness = three_point_fits(model_points, predicted)

        distances = misses(model_points, predicted, rotations, translations)
        gamma1, gamma2 = (
            torch.as_tensor(g, dtype=predicted.dtype, device=predicted.device).reshape(-1, 1, 1)
            for g in (config.gamma1, config.gamma2)
        )
        inliers = torch.sigmoid(gamma1 * (gamma2 - distances))
        if weights is None:
            weights = predicted.new_ones(predicted.shape[:2])
        scores = (inliers @ weights.to(inliers.dtype)[..., None])[..., 0]

        # softmax(p log s) = s^p / sum s^p. Degenerate triples come last: if a pose has no others,
        # the least degenerate ones still make a finite answer.
        alpha = torch.softmax(config.sharpness * (scores + 1e-12).log() - 1e4 * flatness, dim=-1)
        mean_rotation = (alpha[:, None, None] @ rotations)[:, :, 0]
        mean_translation = (alpha[:, None] * translations).sum(dim=-1)
        rotation = project_to_rotation(mean_rotation)
        # A rotation turns about the model's centroid, which stays where the hypotheses put it.
        centroid = model_points.mean(dim=-2)[..., None]
        translation = mean_translation + ((mean_rotation - rotation) @ centroid)[..., 0]
    return SoftRansacResult(rotation, translation, alpha)


def kabsch(
    model_points: torch.Tensor, predicted: torch.Tensor, weights: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Least-squares rigid motion of all points (Kabsch 1976), differentiable.

    Args:
        model_points: (K, 3) or (B, K, 3).
        predicted: (B, K, 3).
        weights: of the squared distances, (B, K), not negative; 1 if None.

    Returns:
        Rotation (B, 3, 3) and translation (B, 3), model to predicted.

    Raises:
        ValueError: if shapes do not match.
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
        rotation = project_to_rotation(covariance)
        translation = centroid - (rotation @ model_centroid[..., None])[..., 0]
    return rotation, translation


def project_to_rotation(matrices: torch.Tensor) -> torch.Tensor:
    """The rotations nearest to matrices (..., 3, 3) in the Frobenius norm.

    The gradient is that of the polar decomposition itself. Unlike the gradient of the singular
    vectors it is finite at equal singular values, where an average of rotations always is.
    """
    if torch.is_grad_enabled() and matrices.requires_grad:
        return _ProjectToRotation.apply(matrices)
    return _polar(matrices)[0]


def _polar(matrices: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Rotation R of M = R P, the eigenvalues (..., 3) of P, and its eigenvectors in rows."""
    u, s, vt = torch.linalg.svd(matrices)
    turn = u @ vt
    # The determinant of an orthogonal matrix by its rows, which is quicker than torch.linalg.det.
    sign = (torch.linalg.cross(turn[..., 0, :], turn[..., 1, :]) * turn[..., 2, :]).sum(-1).sign()
    flip = torch.ones_like(s)
    flip[..., 2] = sign
    return (u * flip[..., None, :]) @ vt, s * flip, vt


class _ProjectToRotation(torch.autograd.Function):
    """M = R P with R a rotation and P symmetric; see ``project_to_rotation``."""

    @staticmethod
    def forward(ctx: Any, matrices: torch.Tensor) -> torch.Tensor:  # type: ignore[override]
        rotation, stretch, vt = _polar(matrices)
        ctx.save_for_backward(rotation, stretch, vt)
        return rotation

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: torch.Tensor) -> torch.Tensor:  # type: ignore[override]
        rotation, stretch, vt = ctx.saved_tensors
        # dR = R W with W skew and W P + P W = R^T dM - dM^T R; in the basis of P's eigenvectors
        # the left side is W_ij (p_i + p_j). A sum near zero means the rotation about that axis is
        # undefined; its gradient is bounded.
        sums = stretch[..., :, None] + stretch[..., None, :]
        sums = sums.clamp_min(1e-12).maximum(1e-3 * stretch[..., :1, None])
        inner = vt @ rotation.transpose(-1, -2) @ grad @ vt.transpose(-1, -2)
        skew = (inner - inner.transpose(-1, -2)) / sums
        return rotation @ vt.transpose(-1, -2) @ skew @ vt


def check_points(
    model_points: torch.Tensor, predicted: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Checks the shapes; returns both in one dtype that torch.linalg supports."""
    if predicted.ndim != 3 or predicted.shape[-1] != 3 or predicted.shape[1] < 3:
        raise ValueError(
            f"predicted must be (B, K, 3) with K >= 3, got shape {tuple(predicted.shape)}"
        )
    if model_points.shape not in (predicted.shape, predicted.shape[1:]):
        raise ValueError(
            f"model_points must be {tuple(predicted.shape[1:])} or {tuple(predicted.shape)} to "
            f"match predicted, got shape {tuple(model_points.shape)}"
        )
    dtype = torch.float64 if predicted.dtype == torch.float64 else torch.float32
    return model_points.detach().to(predicted.device, dtype), predicted.to(dtype)
