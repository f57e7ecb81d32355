"""Samples an object's points from the depth map of its crop, in the crop's frame."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from ...core.geometry import grid_matrix

MIN_POINTS = 16
"""Smallest number of points of a useful cloud."""

_MIN_MASK = 0.5
"""Smallest mask probability of a sampled pixel."""

_MAX_DISTANCE = 0.9
"""Largest distance of a point from the cloud's median, in diameters."""


class PointCloud(NamedTuple):
    """N points for each of B crops, in the crop's frame.

    The crop's frame has z along the ray through the crop's center and x along the crop's rows, so
    that it is invariant to the crop's position and rotation in the image.

    Attributes:
        xyz: (B, N, 3) meters.
        pixels: (B, N, 2) in the feature grid.
        valid: (B, N) false for padding.
        center: (B, 3) median of the valid points, meters.
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
    """Samples points of an object from its crop's depth, in float32 also under autocast.

    Args:
        depth: (B, S, S) meters along the camera's z, 0 where unknown.
        mask: (B, G, G) probability that a cell of the feature grid shows the object.
        K: (B, 3, 3) camera of the crop.
        diameter: (B,) of the object, meters.
        count: number of points; with fewer pixels the rest is not valid.
        generator: on the CPU, one or one for each crop, so that all devices sample alike.

    Returns:
        The points, always finite.
    """
    batch, side = depth.shape[:2]
    inside = F.interpolate(mask[:, None], size=(side, side), mode="bilinear")
    usable = (depth > 0) & (inside[:, 0] > _MIN_MASK)
    if isinstance(generator, torch.Generator):
        keys = torch.rand((batch, side * side), generator=generator, device="cpu")
    else:
        keys = torch.stack([torch.rand(side**2, generator=g, device="cpu") for g in generator])
    keys = keys.to(depth.device)
    keys, index = torch.where(usable.flatten(1), keys, -1.0).topk(count, sorted=False)
    valid = keys >= 0
    z = torch.where(valid, depth.flatten(1).gather(1, index), 1.0)
    pixels = torch.stack([index % side, index // side, torch.ones_like(index)], -1).to(depth.dtype)

    to_grid = torch.from_numpy(grid_matrix(side // mask.shape[-1])).to(depth)
    # In bfloat16, whose steps at a meter are 8 mm, points would move.
    with torch.autocast(depth.device.type, enabled=False):
        R_crop_cam = crop_frame(K, side)
        rays = pixels @ torch.linalg.inv(K).mT
        xyz = (rays * z[..., None]) @ R_crop_cam.mT
        grid_pixels = (pixels @ to_grid.mT)[..., :2]
    center = _median(xyz, valid)
    valid = valid & ((xyz - center[:, None]).norm(dim=-1) < _MAX_DISTANCE * diameter[:, None])
    center = _median(xyz, valid)
    return PointCloud(
        xyz=torch.where(valid[..., None], xyz, center[:, None]),
        pixels=grid_pixels,
        valid=valid,
        center=center,
        R_crop_cam=R_crop_cam,
    )


def crop_frame(K: Tensor, side: int) -> Tensor:
    """Rotations (B, 3, 3) from the camera to the frames of crops with cameras K."""
    backward = torch.linalg.inv(K)
    middle = (side - 1) / 2
    forward = backward @ K.new_tensor([middle, middle, 1.0])
    forward = forward / forward.norm(dim=-1, keepdim=True)
    right = backward[..., 0]
    right = right - (right * forward).sum(-1, keepdim=True) * forward
    right = right / right.norm(dim=-1, keepdim=True)
    return torch.stack([right, torch.linalg.cross(forward, right), forward], -2)


def _median(xyz: Tensor, valid: Tensor) -> Tensor:
    """Median (B, 3) of the valid points (B, N, 3), by coordinate; (0, 0, 1) if none."""
    known = torch.where(valid[..., None], xyz, torch.nan).nanmedian(dim=1).values
    return torch.where(valid.any(1)[:, None], known, xyz.new_tensor([0.0, 0.0, 1.0]))
