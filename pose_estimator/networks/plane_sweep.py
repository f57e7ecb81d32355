"""Plane sweep: warps another view into the reference view at depth hypotheses.

A plane z = d in front of the reference camera maps its pixels to another view by the homography

    H(d) = K_view (R + t n^T / d) K_ref^-1,    n = (0, 0, 1)

(Collins, CVPR 1996; Yao et al., "MVSNet", ECCV 2018, equation 1), with R and t from the reference
to the view. The camera matrices may be those of crops, i.e. any affine map times the true ones.
Computes in float32 at least: at a meter bfloat16 has steps of 8 mm.
"""

import torch
from torch import Tensor
from torch.nn import functional as F

_MIN_DEPTH = 0.05
"""Smallest depth in meters of a visible point in the other view."""


def sweep_pixels(
    K_ref: Tensor, K_view: Tensor, T_view_ref: Tensor, depth: Tensor
) -> tuple[Tensor, Tensor]:
    """Maps the reference's pixels to another view, given a depth at each.

    Each pixel has the homography of its own plane, so planes may follow an earlier depth map.

    Args:
        K_ref: (B, 3, 3), of the grid on which ``depth`` lies.
        K_view: (B, 3, 3), of the grid in which the pixels are wanted.
        T_view_ref: (B, 4, 4), meters.
        depth: (B, D, H, W), m.

    Returns:
        Pixels (B, D, H, W, 2), and depths in the other view (B, D, H, W) in meters: the view
        sees only points whose depth is positive.
    """
    height, width = depth.shape[2:]
    rows = torch.arange(height, dtype=depth.dtype, device=depth.device)
    columns = torch.arange(width, dtype=depth.dtype, device=depth.device)
    v, u = torch.meshgrid(rows, columns, indexing="ij")
    pixels = torch.stack([u, v, torch.ones_like(u)]).reshape(3, -1)
    rotated = K_view @ T_view_ref[:, :3, :3] @ torch.linalg.inv(K_ref)
    rays = (rotated @ pixels).reshape(-1, 3, 1, height, width)
    epipole = (K_view @ T_view_ref[:, :3, 3:]).reshape(-1, 3, 1, 1, 1)
    x, y, z = (rays * depth[:, None] + epipole).unbind(1)
    positive = z.clamp(min=_MIN_DEPTH)
    return torch.stack([x / positive, y / positive], -1), z


def sweep(
    features: Tensor, K_ref: Tensor, K_view: Tensor, T_view_ref: Tensor, depth: Tensor
) -> tuple[Tensor, Tensor]:
    """Warps another view's features into the reference view at depth hypotheses.

    Args:
        features: (B, C, h, w) of the other view, on the grid of ``K_view``.
        K_ref, K_view, T_view_ref, depth: see :func:`sweep_pixels`; depths get no gradient.

    Returns:
        Features (B, C, D, H, W), and whether the view shows the point, (B, D, H, W).
    """
    pixels, z = sweep_pixels(K_ref, K_view, T_view_ref, depth.detach())
    size = pixels.new_tensor([features.shape[3] - 1, features.shape[2] - 1])
    grid = pixels * (2 / size) - 1
    inside = (grid.abs().amax(-1) <= 1) & (z > _MIN_DEPTH)
    planes, height, width = depth.shape[1:]
    warped = F.grid_sample(
        features.float(),
        grid.reshape(len(grid), planes * height, width, 2),
        mode="bilinear",
        padding_mode="border",
        align_corners=True,
    )
    return warped.unflatten(2, (planes, height)), inside


def group_correlation(reference: Tensor, warped: Tensor, groups: int) -> Tensor:
    """Group-wise correlation of the reference and a warped view.

    Guo et al., "Group-wise correlation stereo network", CVPR 2019, equation 5.

    Args:
        reference: (B, C, H, W).
        warped: (B, C, D, H, W).
        groups: a divisor of C.

    Returns:
        (B, groups, D, H, W) mean products of the channels of each group.
    """
    product = reference.float().unsqueeze(2) * warped
    return product.unflatten(1, (groups, -1)).mean(2)
