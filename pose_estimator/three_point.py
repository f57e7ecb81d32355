"""The rigid motion of every three keypoints, all hypotheses of all poses at once.

A three-point fit needs no singular value decomposition. Two centred triangles span one plane each;
the best rotation (Kabsch) lays one plane on the other and then turns it in the plane, and that turn
is the two-dimensional Procrustes angle, which has a closed form. All triangles of all poses are
solved in a few batched operations.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

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
    model = _model_triangles(model_points, corners)
    frames, a_x, b_x, b_y = model.frames, model.a_x, model.b_x, model.b_y

    first, edge_a, edge_b = _corner_and_edges(predicted, corners)
    cross = torch.linalg.cross(edge_a, edge_b)
    flat = cross.detach().norm(dim=-1) <= _FLATTEST_PREDICTED_TRIANGLE * model.area
    unusable = (flat | model.flat)[..., None]
    # Stand-ins keep the unused branch finite, so that its zero gradient is zero and not NaN.
    axes = _axes(predicted.dtype, predicted.device)
    normal = _unit(torch.where(unusable, axes[2], cross))
    # In the plane, with points as complex numbers, the best turn is along sum b conj(a). The a are
    # centred, so the b need not be, and corner 0 may be their origin.
    real = edge_a * (2 * a_x - b_x) + edge_b * (2 * b_x - a_x)
    imaginary = (2 * edge_b - edge_a) * b_y
    turn = real - torch.linalg.cross(normal, imaginary)
    turn = _unit(torch.where(unusable, axes[0], turn))
    triad = (turn, torch.linalg.cross(normal, turn), normal)

    theirs = "khj" if model_points.ndim == 2 else "bkhj"
    rotations = torch.einsum(f"bkhi,{theirs}->bihj", torch.stack(triad, 1), torch.stack(frames, -3))
    turned = sum(ours * part for ours, part in zip(triad, model.centroid, strict=True))
    centroid = first + (edge_a + edge_b) / 3
    translations = (centroid - turned).transpose(1, 2)
    flatness = flat.to(predicted.dtype) + 2 * model.flat.to(predicted.dtype)
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


class _Triangles(NamedTuple):
    """The triangles of a model, (..., H, n) each.

    Attributes:
        frames: axes along an edge, across it, and normal; (..., H, 3) each.
        area: twice the triangle's, (..., H).
        flat: which are no triangles, (..., H).
        a_x: the second corner's coordinate in the frame, less the first's, (..., H, 1).
        b_x: the third's.
        b_y: the third's along the second axis.
        centroid: its coordinates along the frame's axes, from the model's origin, (..., H, 1) each.
    """

    frames: tuple[torch.Tensor, torch.Tensor, torch.Tensor]
    area: torch.Tensor
    flat: torch.Tensor
    a_x: torch.Tensor
    b_x: torch.Tensor
    b_y: torch.Tensor
    centroid: tuple[torch.Tensor, torch.Tensor, torch.Tensor]


def _model_triangles(points: torch.Tensor, corners: torch.Tensor) -> _Triangles:
    """The triangles of a model (K, 3), which are remembered, or of several (B, K, 3)."""
    if points.ndim == 3 or points.device.type != "cpu":
        return _find_triangles(points, corners)
    return _known_triangles(points.numpy().tobytes(), points.shape, points.dtype)


@lru_cache(maxsize=128)
def _known_triangles(content: bytes, shape: torch.Size, dtype: torch.dtype) -> _Triangles:
    # What inference mode makes could not take part in a later training.
    with torch.inference_mode(False):
        points = torch.frombuffer(bytearray(content), dtype=dtype).reshape(shape)
        return _find_triangles(points, _triples(len(points), points.device))


@torch.no_grad()
def _find_triangles(points: torch.Tensor, corners: torch.Tensor) -> _Triangles:
    first, edge_a, edge_b = _corner_and_edges(points, corners)
    cross = torch.linalg.cross(edge_a, edge_b)
    area = cross.norm(dim=-1)
    longest = torch.stack([edge_a, edge_b, edge_b - edge_a]).square().sum(dim=-1).amax(dim=0)
    flat = (area < _FLATTEST_MODEL_TRIANGLE * longest) | (longest <= 0)
    if flat.all(dim=-1).any():
        raise ValueError(
            "model_points lie on one line (or in one point): they do not determine a rotation"
        )
    axes = _axes(points.dtype, points.device)
    along = _unit(torch.where(flat[..., None], axes[0], edge_a))
    normal = _unit(torch.where(flat[..., None], axes[2], cross))
    frames = along, torch.linalg.cross(normal, along), normal
    centroid = first + (edge_a + edge_b) / 3

    def coordinate(vectors: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
        return (vectors * axis).sum(dim=-1, keepdim=True)

    across = frames[1]
    return _Triangles(
        frames=frames,
        area=area,
        flat=flat,
        a_x=coordinate(edge_a, along),
        b_x=coordinate(edge_b, along),
        b_y=coordinate(edge_b, across),
        centroid=(
            coordinate(centroid, along),
            coordinate(centroid, across),
            coordinate(centroid, normal),
        ),
    )


def _corner_and_edges(
    points: torch.Tensor, corners: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """First corner of each triple and the edges to the other two, (..., H, 3) each."""
    first, second, third = (points.index_select(-2, index) for index in corners)
    return first, second - first, third - first


def _unit(vectors: torch.Tensor) -> torch.Tensor:
    return vectors / vectors.norm(dim=-1, keepdim=True)


@lru_cache(maxsize=16)
def _axes(dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """The unit vectors, (3, 3)."""
    with torch.inference_mode(False):  # as for _triples
        return torch.eye(3, dtype=dtype, device=device)


@lru_cache(maxsize=16)
def _triples(count: int, device: torch.device) -> torch.Tensor:
    """Indices of all three-point subsets, (3, H)."""
    # What inference mode makes could not take part in a later training.
    with torch.inference_mode(False):
        return torch.tensor(list(combinations(range(count), 3)), device=device).T.contiguous()
