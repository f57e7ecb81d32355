"""Soft RANSAC: one pose from nine 3D keypoints, differentiably and in spite of outliers.

The solver of the paper. Every triple of keypoints gives one rigid hypothesis, C(9, 3) = 84 in all;
every hypothesis is scored by how many keypoints it brings near their predictions,

    s_k = sum_i sigmoid(gamma1 * (gamma2 - d_ki)),    d_ki = |R_k m_i + t_k - p_i|,

and the hypotheses are averaged in proportion to their scores. The average of rotations is projected
back onto SO(3).

A three-point fit needs no singular value decomposition. Two centred triangles span one plane each;
the best rotation (Kabsch) lays one plane on the other and then turns it in the plane, and that turn
is the two-dimensional Procrustes angle, which has a closed form. All triangles of all poses are
solved in a few batched operations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import Any

import torch
from torch.autograd.function import once_differentiable

_FLATTEST_MODEL_TRIANGLE = 0.02
"""Height over longest side below which a model triple counts as collinear."""

_FLATTEST_PREDICTED_TRIANGLE = 0.01
"""Area over the model triangle's area below which a predicted triple says nothing of rotation."""


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
    model_points, predicted = _check_points(model_points, predicted)
    with torch.autocast(predicted.device.type, enabled=False):
        triangles = _model_triangles(model_points)
        rotations, centroids, flat = _triangle_fits(triangles, predicted)

        # (B, H, 3, K): each hypothesis applied to all model points.
        moved = rotations @ triangles.local_points + centroids[..., None]
        squared = (moved - predicted.transpose(1, 2)[:, None]).square().sum(dim=2)
        distances = (squared + 1e-12).sqrt()  # smooth at zero
        gamma1, gamma2 = (
            torch.as_tensor(g, dtype=predicted.dtype, device=predicted.device).reshape(-1, 1, 1)
            for g in (config.gamma1, config.gamma2)
        )
        inliers = torch.sigmoid(gamma1 * (gamma2 - distances))
        if weights is not None:
            inliers = inliers * weights.to(inliers.dtype)[:, None]
        scores = inliers.sum(dim=-1)

        # softmax(p log s) = s^p / sum s^p. Degenerate triples come last: if a pose has no others,
        # the least degenerate ones still make a finite answer.
        penalty = 1e4 * flat.to(scores.dtype) + 2e4 * triangles.flat.to(scores.dtype)
        alpha = torch.softmax(config.sharpness * (scores + 1e-12).log() - penalty, dim=-1)

        mean_rotation = torch.einsum(
            "bh,bhij->bij", alpha, rotations @ triangles.frames.transpose(-1, -2)
        )
        rotation = project_to_rotation(mean_rotation)
        # Where the hypotheses put the model's centroid; a rotation turns about it.
        moved_centroid = torch.einsum("bh,bhi->bi", alpha, moved.mean(dim=-1))
        model_centroid = model_points.mean(dim=-2)
        translation = moved_centroid - (rotation @ model_centroid[..., None])[..., 0]
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
    model_points, predicted = _check_points(model_points, predicted)
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
    return _ProjectToRotation.apply(matrices)


class _ProjectToRotation(torch.autograd.Function):
    """M = R P with R a rotation and P symmetric; see ``project_to_rotation``."""

    @staticmethod
    def forward(ctx: Any, matrices: torch.Tensor) -> torch.Tensor:  # type: ignore[override]
        u, s, vt = torch.linalg.svd(matrices)
        sign = torch.linalg.det(u @ vt).sign()
        flip = torch.ones_like(s)
        flip[..., 2] = sign
        rotation = (u * flip[..., None, :]) @ vt
        ctx.save_for_backward(rotation, s * flip, vt)
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


@dataclass(frozen=True, eq=False)
class _ModelTriangles:
    """What the fits need of the model: (..., H triples), one leading axis if the model has one.

    Attributes:
        corners: (H, 3) indices of the keypoints.
        frames: (..., H, 3, 3), columns: an in-plane axis, the other, the normal.
        corners_2d: (..., H, 3, 2), centred corners in the plane.
        local_points: (..., H, 3, K), all keypoints in the triangle's frame.
        area: (..., H), twice the area.
        flat: (..., H) bool, collinear.
    """

    corners: torch.Tensor
    frames: torch.Tensor
    corners_2d: torch.Tensor
    local_points: torch.Tensor
    area: torch.Tensor
    flat: torch.Tensor


@torch.no_grad()
def _model_triangles(points: torch.Tensor) -> _ModelTriangles:
    corners = _triples(points.shape[-2], points.device)
    triangles = _gather(points, corners)
    centroid = triangles.mean(dim=-2)
    edge_a = triangles[..., 1, :] - triangles[..., 0, :]
    edge_b = triangles[..., 2, :] - triangles[..., 0, :]
    cross = torch.linalg.cross(edge_a, edge_b)
    area = cross.norm(dim=-1)
    longest = torch.stack([edge_a, edge_b, edge_b - edge_a]).square().sum(dim=-1).amax(dim=0)
    flat = area < _FLATTEST_MODEL_TRIANGLE * longest
    flat |= longest <= 0
    if flat.all(dim=-1).any():
        raise ValueError(
            "model_points lie on one line (or in one point): they do not determine a rotation"
        )
    # A finite stand-in for collinear triples, which get no weight.
    fallback = torch.eye(3, dtype=points.dtype, device=points.device)
    first = torch.where(flat[..., None], fallback[0], edge_a)
    first = first / first.norm(dim=-1, keepdim=True)
    normal = torch.where(flat[..., None], fallback[2], cross)
    normal = normal / normal.norm(dim=-1, keepdim=True)
    frames = torch.stack([first, torch.linalg.cross(normal, first), normal], dim=-1)
    local_corners = (triangles - centroid[..., None, :]) @ frames
    local_points = (points[..., None, :, :] - centroid[..., None, :]) @ frames
    return _ModelTriangles(
        corners=corners,
        frames=frames,
        corners_2d=local_corners[..., :2],
        local_points=local_points.transpose(-1, -2),
        area=area,
        flat=flat,
    )


def _triangle_fits(
    model: _ModelTriangles, predicted: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Kabsch of every triple in closed form.

    Returns:
        Rotations (B, H, 3, 3) from the *triangle's frame* to the camera, centroids (B, H, 3), and
        which predicted triples are degenerate (B, H).
    """
    triangles = _gather(predicted, model.corners)
    centroids = triangles.mean(dim=-2)
    edge_a = triangles[..., 1, :] - triangles[..., 0, :]
    edge_b = triangles[..., 2, :] - triangles[..., 0, :]
    cross = torch.linalg.cross(edge_a, edge_b)
    flat = cross.detach().norm(dim=-1) <= _FLATTEST_PREDICTED_TRIANGLE * model.area
    flat |= model.flat
    # Stand-ins keep the unused branch finite, so that its zero gradient is zero and not NaN.
    axes = torch.eye(3, dtype=predicted.dtype, device=predicted.device)
    normal = torch.where(flat[..., None], axes[2], cross)
    normal = normal / normal.norm(dim=-1, keepdim=True)
    # In the plane, with points as complex numbers, the best turn is along sum b conj(a).
    h = (triangles - centroids[..., None, :]).transpose(-1, -2) @ model.corners_2d
    turn = h[..., 0] - torch.linalg.cross(normal, h[..., 1])
    turn = torch.where(flat[..., None], axes[0], turn)
    turn = turn / turn.norm(dim=-1, keepdim=True)
    rotations = torch.stack([turn, torch.linalg.cross(normal, turn), normal], dim=-1)
    return rotations, centroids, flat


def _gather(points: torch.Tensor, corners: torch.Tensor) -> torch.Tensor:
    """(..., K, 3) at (H, 3) indices: (..., H, 3, 3), one row a corner."""
    gathered = points.index_select(-2, corners.reshape(-1))
    return gathered.unflatten(-2, corners.shape)


@lru_cache(maxsize=16)
def _triples(count: int, device: torch.device) -> torch.Tensor:
    return torch.tensor(list(combinations(range(count), 3)), device=device)


def _check_points(
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
