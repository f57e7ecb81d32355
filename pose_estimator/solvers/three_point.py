"""Rigid motions of all triples of keypoints, for all poses at once.

A three-point fit needs no singular value decomposition. Two centered triangles span one plane each;
the best rotation (Kabsch) aligns the planes and then rotates in the plane by the two-dimensional
Procrustes angle, which has a closed form.

What depends on the model alone is computed once for each model. Vectors are stored by coordinate,
(3, B, H), so that the rest is a few operations on long rows.
"""

from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import torch

from ...core.errors import InputError

_MIN_MODEL_HEIGHT = 0.02
"""Height over longest side below which a model triple counts as collinear."""

_MIN_PREDICTED_AREA = 0.01
"""Area over the model triangle's area below which a predicted triple is degenerate."""


class _Triangles(NamedTuple):
    """The triangles of a model; the dimension B exists if each pose has its own model.

    Attributes:
        sums: weights of the keypoints, (5, [B,] K, H), in the two edges from the first corner, in
            the real and the imaginary part of the in-plane rotation, and in the centroid.
        min_area: squared double area up to which a predicted triangle is degenerate, ([B,] H);
            infinite where the model's triangle is.
        coordinates: of all keypoints along axes by an edge, across it and normal, from the
            centroid, (3, B or 1, K, H).
        shares: contributions of the axes, and last of the centroid, to the rotation (3 columns)
            and to the position of the model's center (1 column), (4, [B,] H, 4); repeated for each
            of x, y, z if poses share the model, (12, H, 4).
        center: mean of the keypoints, ([B,] 3).
    """

    sums: torch.Tensor
    min_area: torch.Tensor
    coordinates: torch.Tensor
    shares: torch.Tensor
    center: torch.Tensor


class Hypotheses(NamedTuple):
    """The motions of H triples of keypoints of B poses.

    Each maps the centroid and the axes of the model's triangle to those of the predicted one.

    Attributes:
        axes: of the predicted triangles; coordinate, axis, pose, triple: (3, 3, B, H).
        centroids: of the predicted triangles, from ``origin``, (3, B, H).
        origin: (B, 1, 3).
        points: the predicted keypoints from ``origin``, (B, K, 3).
        degenerate: triples that do not constrain the rotation, (B, H); their motions are finite.
        triangles: of the model.
    """

    axes: torch.Tensor
    centroids: torch.Tensor
    origin: torch.Tensor
    points: torch.Tensor
    degenerate: torch.Tensor
    triangles: _Triangles

    def residuals(self) -> torch.Tensor:
        """Distances d_ki in meters of every keypoint under every hypothesis, (B, K, H)."""
        points = torch.cat([self.points] * 3)
        axes = self.axes.flatten(1, 2).transpose(0, 1)  # (3 B, 3, H)
        # Along each axis: the model's keypoint minus the predicted one.
        centroids = (self.axes * self.centroids[:, None]).sum(dim=0)
        offsets = (centroids[:, :, None] + self.triangles.coordinates).flatten(0, 1)
        offsets = offsets.baddbmm_(points, axes, alpha=-1).unflatten(0, (3, len(self.points)))
        return ((offsets * offsets).sum(dim=0) + 1e-12).sqrt()  # smooth at zero

    def average(self, weights: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Weighted means of the rotations (B, 3, 3) and of the model center's positions (B, 3).

        The ``weights`` (B, H) of a pose's triples sum to one.
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
    degenerate = doubled_area <= triangles.min_area
    # Degenerate normals are not normalized, so that no gradient is NaN.
    normal = cross * doubled_area.masked_fill(degenerate, 1.0).rsqrt()
    # In the plane, with points as complex numbers, the best rotation is along sum b conj(a); a
    # quarter turn is a cross product with the normal.
    quarter = _cross(torch.cat([normal, normal[:2]]), sums[2:4])
    along, across = sums[2, :3] - quarter[1], sums[3, :3] + quarter[0]
    scale = (along * along).sum(dim=0).masked_fill(degenerate, 1.0).rsqrt()
    axes = torch.stack([along * scale, across * scale, normal], dim=1)
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
    """Cross products (..., 3, B, H) of vectors given as x, y, z, x, y, (..., 5, B, H)."""
    a_next, a_last = a.narrow(-3, 1, 3), a.narrow(-3, 2, 3)
    b_next, b_last = b.narrow(-3, 1, 3), b.narrow(-3, 2, 3)
    return torch.addcmul(a_next * b_last, a_last, b_next, value=-1)


def _model_triangles(points: torch.Tensor) -> _Triangles:
    """The triangles of a model (K, 3), which are cached, or of several (B, K, 3)."""
    if points.ndim == 3 or points.device.type != "cpu":
        return _find_triangles(points)
    return _cached_triangles(points.cpu().numpy().tobytes(), points.shape, points.dtype)


@lru_cache(maxsize=128)
def _cached_triangles(content: bytes, shape: torch.Size, dtype: torch.dtype) -> _Triangles:
    # Tensors made in inference mode cannot be used in training.
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
    # Degenerate triangles are replaced by placeholders, which keep everything finite.
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
        min_area=torch.where(flat, torch.inf, (_MIN_PREDICTED_AREA * area).square()),
        coordinates=coordinates if points.ndim == 3 else coordinates[:, None],
        shares=shares if points.ndim == 3 else shares.repeat(3, 1, 1),
        center=center,
    )


def _unit(vectors: torch.Tensor) -> torch.Tensor:
    return vectors / vectors.norm(dim=-2, keepdim=True)


@lru_cache(maxsize=16)
def _corners(count: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """One-hot keypoints of the three corners of each triple, (3, K, H)."""
    # Tensors made in inference mode cannot be used in training.
    with torch.inference_mode(False):
        triples = torch.tensor(list(combinations(range(count), 3)), device=device)  # (H, 3)
        return torch.eye(count, dtype=dtype, device=device)[triples].permute(1, 2, 0).contiguous()
