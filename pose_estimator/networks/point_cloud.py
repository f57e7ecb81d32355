"""The points of an object that a depth sensor sees in a crop, in a frame that fits the crop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from ...core.geometry import grid_matrix

MIN_POINTS = 16
"""With fewer points, a cloud says next to nothing."""

_MIN_MASK = 0.5
"""Least mask probability of a pixel whose depth is taken."""

_MAX_DISTANCE = 0.9
"""Diameters from the middle of the cloud beyond which a point is on something else."""


class PointCloud(NamedTuple):
    """N points for each of B crops, in the crop's frame.

    The crop's frame looks along the ray through the middle of the crop, with its x axis along the
    crop's rows: what a crop shows says how the object stands to that ray, wherever in the image
    the crop was cut and however it was turned.

    Attributes:
        xyz: (B, N, 3) meters.
        pixels: (B, N, 2) where the points are in the feature grid.
        valid: (B, N) false for what only fills the row.
        center: (B, 3) the median of the valid points, meters.
        R_crop_cam: (B, 3, 3).
    """

    xyz: Tensor
    pixels: Tensor
    valid: Tensor
    center: Tensor
    R_crop_cam: Tensor


def sample_points(
    depth: Tensor,
    mask: Tensor,
    K: Tensor,
    diameter: Tensor,
    count: int,
    generator: torch.Generator | Sequence[torch.Generator],
) -> PointCloud:
    """Draws points of an object from its crop's depth.

    Args:
        depth: (B, S, S) meters along the camera's z, 0 where unknown.
        mask: (B, G, G) probability that a cell of the feature grid shows the object.
        K: (B, 3, 3) camera of the crop; any affine of a camera's.
        diameter: (B,) of the object, meters.
        count: how many points; where there are fewer pixels, the rest is not valid.
        generator: of the draws, one or one for each crop, on the CPU: so every device draws alike.

    Returns:
        The points. A crop without any has none that are valid, and finite numbers.
    """
    batch, side = depth.shape[:2]
    inside = F.interpolate(mask[:, None], size=(side, side), mode="bilinear", align_corners=False)[
        :, 0
    ]
    usable = (depth > 0) & (inside > _MIN_MASK)
    if isinstance(generator, torch.Generator):
        keys = torch.rand((batch, side * side), generator=generator, device="cpu")
    else:
        keys = torch.stack(
            [torch.rand(side * side, generator=own, device="cpu") for own in generator]
        )
    keys = keys.to(depth.device)
    keys, index = torch.where(usable.flatten(1), keys, -1.0).topk(count, sorted=False)
    valid = keys >= 0
    z = torch.where(valid, depth.flatten(1).gather(1, index), 1.0)
    pixels = torch.stack([index % side, index // side, torch.ones_like(index)], -1).to(depth.dtype)

    R_crop_cam = crop_frame(K, side)
    rays = pixels @ torch.linalg.inv(K).mT
    xyz = (rays * z[..., None]) @ R_crop_cam.mT
    center = _median(xyz, valid)
    valid = valid & ((xyz - center[:, None]).norm(dim=-1) < _MAX_DISTANCE * diameter[:, None])
    center = _median(xyz, valid)
    to_grid = torch.from_numpy(grid_matrix(side // mask.shape[-1])).to(depth)
    return PointCloud(
        xyz=torch.where(valid[..., None], xyz, center[:, None]),
        pixels=(pixels @ to_grid.mT)[..., :2],
        valid=valid,
        center=center,
        R_crop_cam=R_crop_cam,
    )


def crop_frame(K: Tensor, side: int) -> Tensor:
    """Rotations (B, 3, 3) from the camera to the frames of crops with cameras K and a side."""
    backward = torch.linalg.inv(K)
    middle = (side - 1) / 2
    forward = backward @ K.new_tensor([middle, middle, 1.0])
    forward = forward / forward.norm(dim=-1, keepdim=True)
    right = backward[..., 0]
    right = right - (right * forward).sum(-1, keepdim=True) * forward
    right = right / right.norm(dim=-1, keepdim=True)
    return torch.stack([right, torch.linalg.cross(forward, right), forward], -2)


def _median(xyz: Tensor, valid: Tensor) -> Tensor:
    """The median (B, 3) of the valid ones of points (B, N, 3), by coordinate; (0, 0, 1) if none."""
    known = torch.where(valid[..., None], xyz, torch.nan).nanmedian(dim=1).values
    return torch.where(valid.any(1)[:, None], known, xyz.new_tensor([0.0, 0.0, 1.0]))
