"""The rigid motion of every three keypoints, all hypotheses of all poses at once.

A three-point fit needs no singular value decomposition. Two centered triangles span one plane each;
the best rotation (Kabsch) lays one plane on the other and then turns it in the plane, and that turn
is the two-dimensional Procrustes angle, which has a closed form.

All that depends on the model alone is worked out once for each model. What is left are a few
operations on long rows, one number for each triangle: vectors lie as their coordinates, (3, B, H).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import torch

from ...core.errors import InputError

_MIN_MODEL_HEIGHT = 0.02
"""Height over longest side below which a model triple counts as collinear."""

_MIN_PREDICTED_AREA = 0.01
"""Area over the model triangle's area below which a predicted triple says nothing of rotation."""


class _Triangles(NamedTuple):
    """What the triangles of a model are; the B is there if each pose has a model of its own.

    Attributes:
        sums: weights of the keypoints, (5, [B,] K, H), in the two edges from the first corner, in
            the real and the imaginary part of the turn, and in the centroid.
        smallest: squared double area up to which a predicted triangle is of no use, ([B,] H);
            infinite where the model's is none.
        coordinates: of all keypoints along axes by an edge, across it and normal, from the
            centroid, (3, B or 1, K, H).
        shares: what each axis, and last the centroid, adds to the rotation and, beside it, to
            where the model's center goes, (4, [B,] H, 4); three times over, one for each of x, y,
            z, if poses share the model, (12, H, 4).
        center: mean of the keypoints, ([B,] 3).
    """

    sums: torch.Tensor
    smallest: torch.Tensor
    coordinates: torch.Tensor
    shares: torch.Tensor
    center: torch.Tensor


class Hypotheses(NamedTuple):
    """The motions of H triples of keypoints of B poses.

    Each lays the model's triangle on the predicted one: centroid on centroid, and the axes of the
    one on those of the other.

    Attributes:
        axes: of the predicted triangles; coordinate, axis, pose, triple: (3, 3, B, H).
        centroids: of the predicted triangles, from ``origin``, (3, B, H).
        origin: (B, 1, 3).
        points: the predicted keypoints from ``origin``, (B, K, 3).
        degenerate: triples that say nothing of rotation, (B, H); their motions are finite, no more.
        triangles: of the model.
    """

    axes: torch.Tensor
    centroids: torch.Tensor
    origin: torch.Tensor
    points: torch.Tensor
    degenerate: torch.Tensor
    triangles: _Triangles

    def residuals(self) -> torch.Tensor:
        """Distance in meters of every keypoint from where every triple puts it, (B, K, H)."""
        points = torch.cat([self.points] * 3)
        axes = self.axes.flatten(1, 2).transpose(0, 1)  # (3 B, 3, H)
        # Along each axis: where a keypoint should be, less where it is.
        centroids = (self.axes * self.centroids[:, None]).sum(dim=0)
        offsets = (centroids[:, :, None] + self.triangles.coordinates).flatten(0, 1)
        offsets = offsets.baddbmm_(points, axes, alpha=-1).unflatten(0, (3, len(self.points)))
        return ((offsets * offsets).sum(dim=0) + 1e-12).sqrt()  # smooth at zero

    def average(self, weights: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Weighted sums of the motions.

        Args:
            weights: of the triples, (B, H); a pose's sum to one.

        Returns:
            Of rotations, (B, 3, 3), in general none itself; and of where the mean of the model's
            keypoints goes, (B, 3).
        """
        parts = torch.cat([self.axes, self.centroids[:, None]], dim=1) * weights
        shares = self.triangles.shares
        if shares.ndim == 4:  # a model for each pose
            sums = torch.einsum("ckbh,kbhj->bcj", parts, shares)
        else:
            sums = torch.bmm(parts.flatten(0, 1), shares).unflatten(0, (3, 4))
            sums = sums.sum(dim=1).transpose(0, 1)
        return sums[..., :3], sums[..., 3] + self.origin[:, 0]


def three_point_fits(model_points: torch.Tensor, predicted: torch.Tensor) -> Hypotheses:
    """Kabsch of every triple in closed form.

    Args:
        model_points: (K, 3) or (B, K, 3), meters.
        predicted: (B, K, 3), meters.

    Raises:
        InputError: if all keypoints of a model lie on one line.
    """
    triangles = _model_triangles(model_points)
    origin = predicted[:, :1]
    points = predicted - origin
    sums = _sums(points, triangles.sums)
    cross = _cross(sums[0], sums[1])
    doubled_area = (cross * cross).sum(dim=0)
    degenerate = doubled_area <= triangles.smallest
    # Those stay as they are: what has no direction has no gradient of it either, not even NaN.
    normal = cross * doubled_area.masked_fill(degenerate, 1.0).rsqrt()
    # In the plane, with points as complex numbers, the best turn is along sum b conj(a); a quarter
    # turn is a cross product with the normal.
    quarter = _cross(torch.cat([normal, normal[:2]]), sums[2:4])
    turn, across = sums[2, :3] - quarter[1], sums[3, :3] + quarter[0]
    scale = (turn * turn).sum(dim=0).masked_fill(degenerate, 1.0).rsqrt()
    axes = torch.stack([turn * scale, across * scale, normal], dim=1)
    return Hypotheses(axes, sums[4, :3], origin, points, degenerate, triangles)


def _sums(points: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Five weighted sums of points (B, K, 3), each as x, y, z, x, y: (5, 5, B, H)."""
    rows = points.permute(2, 0, 1)
    rows = torch.cat([rows, rows[:2]])
    if weights.ndim == 4:  # a model for each pose
        return torch.einsum("cbk,fbkh->fcbh", rows, weights)
    sums = torch.bmm(rows.flatten(0, 1).expand(len(weights), -1, -1), weights)
    return sums.unflatten(1, rows.shape[:2])


def _cross(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Cross products (..., 3, B, H) of vectors (..., 5, B, H), x and y of which come twice."""
    a_next, a_last = a.narrow(-3, 1, 3), a.narrow(-3, 2, 3)
    b_next, b_last = b.narrow(-3, 1, 3), b.narrow(-3, 2, 3)
    return torch.addcmul(a_next * b_last, a_last, b_next, value=-1)


def _model_triangles(points: torch.Tensor) -> _Triangles:
    """The triangles of a model (K, 3), which are remembered, or of several (B, K, 3)."""
    if points.ndim == 3 or points.device.type != "cpu":
        return _find_triangles(points)
    return _known_triangles(points.cpu().numpy().tobytes(), points.shape, points.dtype)


@lru_cache(maxsize=128)
def _known_triangles(content: bytes, shape: torch.Size, dtype: torch.dtype) -> _Triangles:
    # What inference mode makes could not take part in a later training.
    with torch.inference_mode(False):
        return _find_triangles(torch.frombuffer(bytearray(content), dtype=dtype).reshape(shape))


@torch.no_grad()
def _find_triangles(points: torch.Tensor) -> _Triangles:
    corners = _corners(points.shape[-2], points.dtype, points.device)  # (3, K, H)
    first, second, third = (points.mT @ corner for corner in corners)  # (..., 3, H)
    edge_a, edge_b = second - first, third - first
    cross = torch.linalg.cross(edge_a, edge_b, dim=-2)
    area = cross.norm(dim=-2)
    longest = torch.stack([edge_a, edge_b, edge_b - edge_a]).square().sum(dim=-2).amax(dim=0)
    flat = (area < _MIN_MODEL_HEIGHT * longest) | (longest <= 0)
    if flat.all(dim=-1).any():
        raise InputError(
            "model_points lie on one line (or in one point): they do not determine a rotation"
        )
    # Flat ones have stand-ins, which keep everything finite.
    x, _, z = torch.eye(3, dtype=points.dtype, device=points.device)[:, :, None]
    along = _unit(torch.where(flat[..., None, :], x, edge_a))
    normal = _unit(torch.where(flat[..., None, :], z, cross))
    across = torch.linalg.cross(normal, along, dim=-2)
    frames = torch.stack([along, across, normal])  # (3, ..., 3, H)

    def coordinate(vectors: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
        return (vectors * axis).sum(dim=-2, keepdim=True)  # (..., 1, H)

    a_x, b_x, b_y = coordinate(edge_a, along), coordinate(edge_b, along), coordinate(edge_b, across)
    centroid = coordinate(first + (edge_a + edge_b) / 3, frames)  # (3, ..., 1, H)
    # The a of sum b conj(a) are centered, so the b need not be, and corner 0 may be their origin.
    to_second, to_third = corners[1] - corners[0], corners[2] - corners[0]
    real = to_second * (2 * a_x - b_x) + to_third * (2 * b_x - a_x)
    imaginary = (2 * to_third - to_second) * b_y
    alike = to_second, to_third, real, imaginary, corners.mean(dim=0)
    coordinates = points @ frames - centroid  # (3, ..., K, H)
    center = points.mean(dim=-2)
    to_center = center[..., None, :] @ frames - centroid  # (3, ..., 1, H)
    shares = torch.cat([frames, to_center], dim=-2)  # (3, ..., 4, H)
    last = torch.zeros_like(shares[:1])
    last[..., 3, :] = 1.0
    shares = torch.cat([shares, last]).mT.contiguous()
    return _Triangles(
        sums=torch.stack(torch.broadcast_tensors(*alike)),
        smallest=torch.where(flat, torch.inf, (_MIN_PREDICTED_AREA * area).square()),
        coordinates=coordinates if points.ndim == 3 else coordinates[:, None],
        shares=shares if points.ndim == 3 else shares.repeat(3, 1, 1),
        center=center,
    )


def _unit(vectors: torch.Tensor) -> torch.Tensor:
    return vectors / vectors.norm(dim=-2, keepdim=True)


@lru_cache(maxsize=16)
def _corners(count: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Which keypoint is which corner of each triple, ones and zeros (3, K, H)."""
    # What inference mode makes could not take part in a later training.
    with torch.inference_mode(False):
        triples = torch.tensor(list(combinations(range(count), 3)), device=device)  # (H, 3)
        return torch.eye(count, dtype=dtype, device=device)[triples].permute(1, 2, 0).contiguous()
