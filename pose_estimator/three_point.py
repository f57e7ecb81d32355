"""The rigid motion of every three keypoints, all hypotheses of all poses at once.

A three-point fit needs no singular value decomposition. Two centred triangles span one plane each;
the best rotation (Kabsch) lays one plane on the other and then turns it in the plane, and that turn
is the two-dimensional Procrustes angle, which has a closed form. All triangles of all poses are
solved in a few batched operations.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations

import torch

_FLATTEST_MODEL_TRIANGLE = 0.02
"""Height over longest side below which a model triple counts as collinear."""

_FLATTEST_PREDICTED_TRIANGLE = 0.01
"""Area over the model triangle's area below which a predicted triple says nothing of rotation."""


def three_point_fits(
    model_points: torch.Tensor, predicted: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Kabsch of every triple in closed form.

    Returns:
        Rotations (B, 3, H, 3), the hypotheses on the third axis; translations (B, 3, H); and how
        degenerate each triple is (B, H): 0 for sound ones, 1 if the predicted points are on one
        line, 2 if the model's are.
    """
    corners = _triples(predicted.shape[1], predicted.device)
    with torch.no_grad():
        model_first, model_a, model_b = _corner_and_edges(model_points, corners)
        frames, model_area, model_flat = _model_frames(model_points, model_a, model_b)
        # The corners 1 and 2, less the centroid and times three, in the plane of the triangle.
        a_x = (model_a * frames[0]).sum(dim=-1, keepdim=True)
        b_x = (model_b * frames[0]).sum(dim=-1, keepdim=True)
        b_y = (model_b * frames[1]).sum(dim=-1, keepdim=True)
        model_centroid = model_first + (model_a + model_b) / 3

    first, edge_a, edge_b = _corner_and_edges(predicted, corners)
    cross = torch.linalg.cross(edge_a, edge_b)
    flat = cross.detach().norm(dim=-1) <= _FLATTEST_PREDICTED_TRIANGLE * model_area
    unusable = (flat | model_flat)[..., None]
    # Stand-ins keep the unused branch finite, so that its zero gradient is zero and not NaN.
    axes = torch.eye(3, dtype=predicted.dtype, device=predicted.device)
    normal = _unit(torch.where(unusable, axes[2], cross))
    # In the plane, with points as complex numbers, the best turn is along sum b conj(a). The a are
    # centred, so the b need not be, and corner 0 may be their origin.
    real = edge_a * (2 * a_x - b_x) + edge_b * (2 * b_x - a_x)
    imaginary = (2 * edge_b - edge_a) * b_y
    turn = real - torch.linalg.cross(normal, imaginary)
    turn = _unit(torch.where(unusable, axes[0], turn))
    triad = (turn, torch.linalg.cross(normal, turn), normal)

    rotations = sum(
        ours.transpose(1, 2)[..., None] * theirs.unsqueeze(-3)
        for ours, theirs in zip(triad, frames, strict=True)
    )
    centroid = first + (edge_a + edge_b) / 3
    translations = centroid.transpose(1, 2) - (rotations * model_centroid.unsqueeze(-3)).sum(dim=-1)
    flatness = flat.to(predicted.dtype) + 2 * model_flat.to(predicted.dtype)
    return rotations, translations, flatness


def misses(
    model_points: torch.Tensor,
    predicted: torch.Tensor,
    rotations: torch.Tensor,
    translations: torch.Tensor,
) -> torch.Tensor:
    """Distance in metres of every keypoint from where every hypothesis puts it, (B, H, K).

    Args:
        model_points: (K, 3) or (B, K, 3).
        predicted: (B, K, 3).
        rotations: (B, 3, H, 3), as ``three_point_fits`` gives them.
        translations: (B, 3, H).
    """
    # (B, 3, H, K): each hypothesis applied to all model points.
    moved = (rotations.flatten(1, 2) @ model_points.transpose(-1, -2)).unflatten(1, (3, -1))
    offsets = moved + translations[..., None] - predicted.transpose(1, 2)[:, :, None]
    return (offsets.square().sum(dim=1) + 1e-12).sqrt()  # smooth at zero


def _model_frames(
    points: torch.Tensor, edge_a: torch.Tensor, edge_b: torch.Tensor
) -> tuple[tuple[torch.Tensor, torch.Tensor, torch.Tensor], torch.Tensor, torch.Tensor]:
    """Axes of the model's triangles (along an edge, across it, normal), areas, and who is flat."""
    cross = torch.linalg.cross(edge_a, edge_b)
    area = cross.norm(dim=-1)
    longest = torch.stack([edge_a, edge_b, edge_b - edge_a]).square().sum(dim=-1).amax(dim=0)
    flat = (area < _FLATTEST_MODEL_TRIANGLE * longest) | (longest <= 0)
    if flat.all(dim=-1).any():
        raise ValueError(
            "model_points lie on one line (or in one point): they do not determine a rotation"
        )
    axes = torch.eye(3, dtype=points.dtype, device=points.device)
    along = _unit(torch.where(flat[..., None], axes[0], edge_a))
    normal = _unit(torch.where(flat[..., None], axes[2], cross))
    return (along, torch.linalg.cross(normal, along), normal), area, flat


def _corner_and_edges(
    points: torch.Tensor, corners: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """First corner of each triple and the edges to the other two, (..., H, 3) each."""
    first, second, third = (points.index_select(-2, index) for index in corners)
    return first, second - first, third - first


def _unit(vectors: torch.Tensor) -> torch.Tensor:
    return vectors / vectors.norm(dim=-1, keepdim=True)


@lru_cache(maxsize=16)
def _triples(count: int, device: torch.device) -> torch.Tensor:
    """Indices of all three-point subsets, (3, H)."""
    # What inference mode makes could not take part in a later training.
    with torch.inference_mode(False):
        return torch.tensor(list(combinations(range(count), 3)), device=device).T.contiguous()
