"""RANSAC voting of keypoints from a vector field, with covariances.

After PVNet (Peng et al., CVPR 2019, section 3.1). Every pixel of the object has a direction to each
keypoint. Pairs of pixels, sampled in proportion to their weight, propose the intersection of their
two lines; a pixel votes for the proposals in its direction. The covariance of the proposals,
weighted by their votes, is the keypoint's uncertainty.

PVNet takes the weighted mean of the proposals; here the inlier lines of the best proposal are
intersected by least squares. The covariance also grows where few pixels vote, where their lines are
nearly parallel, and where they disagree, so that it is usable as a weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import torch

from ...core.errors import InputError

if TYPE_CHECKING:
    from .features import Features2D

_HYPOTHESES = 64
"""Pairs of pixels sampled for each keypoint."""

_INLIER_COSINE = 0.99
"""Smallest cosine between a pixel's direction and that to a proposal it votes for."""

_MAX_PIXELS = 256
"""Pixels sampled without replacement in proportion to weight."""

_HYPOTHESIS_POWER = 6
"""Proposals weigh votes**power in the covariance, to suppress intersections of bad pairs."""

_PRIOR_ANGLE = 0.1
"""Prior standard deviation of directions in radians."""

_PRIOR_PIXELS = 8.0
"""Weight of the prior in pixels."""

_MIN_STD = 0.05
"""Smallest standard deviation of a keypoint, in grid pixels."""


@dataclass(frozen=True, eq=False)
class Votes:
    """Voted keypoints, in pixels (x, y) of the feature grid, top-left pixel center at (0, 0).

    Attributes:
        mean: (B, K, 2).
        covariance: (B, K, 2, 2), grid pixels squared, positive definite.
        score: (B, K), weighted share of inlier pixels, 0 to 1.
    """

    mean: torch.Tensor
    covariance: torch.Tensor
    score: torch.Tensor


@torch.no_grad()
def vote_keypoints(directions: torch.Tensor, weights: torch.Tensor) -> Votes:
    """Votes for each keypoint; no gradient.

    Votes do not depend on the batch or the device: all crops share the CPU's random numbers.

    Args:
        directions: (B, K, 2, H, W), from each pixel to each keypoint, (x, y), of any length.
        weights: of each pixel for each keypoint, (B, K, H, W); not negative.

    Returns:
        Votes, always finite. Without any pixel, the middle of the grid with a covariance of the
        grid's squared diagonal, and score 0.

    Raises:
        InputError: if shapes do not match.
    """
    batch, count, height, width = _check_shapes(directions, weights)
    by_pixel, by_pair = _samples(height * width, count, directions.device)
    with torch.autocast(directions.device.type, enabled=False):
        points, lines, weights = _choose_pixels(directions.float(), weights.float(), by_pixel)
        total = weights.sum(dim=-1)
        middle = points.new_tensor([(width - 1) / 2, (height - 1) / 2])
        extent = float(height**2 + width**2) ** 0.5

        proposals, valid = _propose(points, lines, weights, by_pair)
        # Far intersections are noise; where exactly does not matter.
        proposals = middle + (proposals - middle).clamp(-4 * extent, 4 * extent)
        votes, shares = _count_votes(points - middle, lines, weights, proposals - middle)
        shares = shares * valid

        score, best = shares.max(dim=-1)
        pick = best[..., None, None]
        start = proposals.gather(2, pick.expand(batch, count, 1, 2))[:, :, 0]
        start = torch.where(score[..., None] > 0, start, middle)
        inliers = (
            weights * votes.gather(2, pick.expand(batch, count, 1, weights.shape[-1]))[:, :, 0]
        )
        mean, line_covariance = _intersect(points, lines, inliers, start)
        # Falls back to the best proposal where the intersection is far from it.
        mean = torch.where(((mean - start).norm(dim=-1) < extent)[..., None], mean, start)

        alpha = (shares / score[..., None].clamp_min(1e-12)) ** _HYPOTHESIS_POWER
        alpha = alpha / alpha.sum(dim=-1, keepdim=True).clamp_min(1e-12)
        offsets = proposals - mean[:, :, None]
        spread = (alpha[..., None] * offsets).transpose(-1, -2) @ offsets

        identity = torch.eye(2, dtype=mean.dtype, device=mean.device)
        # Outliers are evidence against the point; without votes it is unknown.
        doubt = (1 - score) ** 2 * 0.25 + (total <= 0) * extent**2 + (score <= 0) * extent**2
        covariance = spread + line_covariance + (doubt[..., None, None] + _MIN_STD**2) * identity
        covariance = covariance.clamp(-16 * extent**2, 16 * extent**2)
    return Votes(mean, covariance, score)


def vote(features: Features2D) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Votes for the keypoints of B crops.

    A pixel's weight is its mask probability times its confidence, the squared length of its vector.

    Returns:
        mean (B, 9, 2), covariance (B, 9, 2, 2) in pixels of the feature grid, and score (B, 9).
    """
    directions = features.directions.detach().float()
    x, y = directions.unbind(2)
    confidence = (x * x + y * y).clamp(max=1.0)
    inside = torch.sigmoid(features.mask_logits.detach().float())
    inside = torch.where(inside > 0.3, inside, torch.zeros_like(inside))
    votes = vote_keypoints(directions, inside[:, None] * confidence)
    return votes.mean, votes.covariance, votes.score


@lru_cache(maxsize=16)
def _samples(pixels: int, count: int, device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Uniform random numbers for pixels (pixels,) and pairs (K, 2 * _HYPOTHESES)."""
    generator = torch.Generator("cpu").manual_seed(0)
    # Tensors made in inference mode cannot be used in training.
    with torch.inference_mode(False):
        by_pixel = torch.rand(pixels, generator=generator, device="cpu")
        by_pair = torch.rand((count, 2 * _HYPOTHESES), generator=generator, device="cpu")
        return by_pixel.to(device), by_pair.to(device)


def _choose_pixels(
    directions: torch.Tensor, weights: torch.Tensor, uniform: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Samples at most ``_MAX_PIXELS`` pixels, the same for all keypoints of an object.

    Returns:
        Their points (B, P, 2), unit directions (B, K, 2, P) and weights (B, K, P).
    """
    batch, count, _, height, width = directions.shape
    pixels = min(_MAX_PIXELS, height * width)
    weights = torch.nan_to_num(weights).clamp_min(0).flatten(-2)
    by_pixel = weights.sum(dim=1)
    if pixels < height * width:
        # Efraimidis and Spirakis 2006: the largest u^(1/w) are a weighted sample.
        keys = uniform.clamp_min(1e-12).log() / by_pixel.clamp_min(1e-12)
        chosen = keys.topk(pixels, dim=-1, sorted=False).indices
    else:
        chosen = torch.arange(pixels, device=by_pixel.device).expand(batch, pixels)
    points = torch.stack([chosen % width, chosen // width], dim=-1).to(directions.dtype)
    lines = directions.flatten(-2).gather(-1, chosen[:, None, None].expand(batch, count, 2, pixels))
    length = lines.square().sum(dim=2).sqrt()
    lines = torch.nan_to_num(lines / length.clamp_min(1e-12)[:, :, None])
    weights = weights.gather(-1, chosen[:, None].expand(batch, count, pixels))
    return points, lines, weights * (length > 1e-6)


def _propose(
    points: torch.Tensor, lines: torch.Tensor, weights: torch.Tensor, uniform: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Intersections (B, K, N, 2) of random pairs of lines, and whether they are not parallel."""
    batch, count, pixels = weights.shape
    cumulative = weights.cumsum(dim=-1)
    drawn = torch.searchsorted(cumulative, uniform * cumulative[..., -1:], right=True)
    drawn = drawn.clamp_max(pixels - 1)
    ends = points[:, None].expand(batch, count, pixels, 2)
    ends = ends.gather(2, drawn[..., None].expand(*drawn.shape, 2))
    ways = lines.gather(-1, drawn[:, :, None].expand(batch, count, 2, 2 * _HYPOTHESES))
    ax, ay = ends[:, :, :_HYPOTHESES].unbind(-1)
    bx, by = ends[:, :, _HYPOTHESES:].unbind(-1)
    ux, uy = ways[..., :_HYPOTHESES].unbind(2)
    vx, vy = ways[..., _HYPOTHESES:].unbind(2)
    sine = ux * vy - uy * vx
    valid = (sine.abs() > 0.02) & (cumulative[..., -1:] > 0)
    along = ((bx - ax) * vy - (by - ay) * vx) / torch.where(valid, sine, torch.ones_like(sine))
    return torch.stack([ax + along * ux, ay + along * uy], dim=-1), valid


def _count_votes(
    points: torch.Tensor, lines: torch.Tensor, weights: torch.Tensor, proposals: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Votes (B, K, N, P) as 0 or 1 and the weighted share (B, K, N) that each proposal gets."""
    # A pixel x with direction d votes for h if d . (h - x) >= c |h - x|. Both sides are matrix
    # products, squared with their sign so that no root is taken.
    square = _INLIER_COSINE**2
    across = points.transpose(1, 2)[:, None]
    along = proposals @ lines - (lines * across).sum(dim=2, keepdim=True)
    from_pixel = torch.cat(
        [across, across.square().sum(dim=2, keepdim=True), torch.ones_like(across[:, :, :1])], dim=2
    ).expand(*proposals.shape[:2], 4, -1)
    from_proposal = square * torch.cat(
        [
            -2 * proposals,
            torch.ones_like(proposals[..., :1]),
            proposals.square().sum(dim=-1, keepdim=True),
        ],
        dim=-1,
    )
    margin = torch.baddbmm(
        (along * along.abs()).flatten(0, 1),
        from_proposal.flatten(0, 1),
        from_pixel.flatten(0, 1),
        alpha=-1,
    ).view_as(along)
    votes = (margin >= 0).to(weights.dtype)
    shares = (votes @ weights[..., None])[..., 0]
    return votes, shares / weights.sum(dim=-1, keepdim=True).clamp_min(1e-12)


def _intersect(
    points: torch.Tensor, lines: torch.Tensor, inliers: torch.Tensor, start: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Least-squares intersection (B, K, 2) of the inlier lines, and its covariance.

    An angular error displaces a line by the angle times its length, so long lines weigh less.
    """
    normals = torch.stack([-lines[:, :, 1], lines[:, :, 0]], dim=2)
    offsets = start[..., None] - points.transpose(1, 2)[:, None]
    precision = 1.0 / (offsets.square().sum(dim=2) + 1.0)
    residuals = -(normals * offsets).sum(dim=2)
    weighted = (inliers * precision)[:, :, None] * normals
    information = weighted @ normals.transpose(-1, -2)
    moment = (weighted * residuals[:, :, None]).sum(dim=-1)
    # A weak prior at the best proposal, for parallel lines.
    ridge = 1e-4 * torch.eye(2, dtype=start.dtype, device=start.device)
    inverse = _inverse_2x2(information + ridge)
    step = (inverse @ moment[..., None])[..., 0]
    squared = (residuals - (normals * step[..., None]).sum(dim=2)).square() * precision
    mass = inliers.sum(dim=-1)
    effective = mass.square() / inliers.square().sum(dim=-1).clamp_min(1e-12)
    scale = mass / effective.clamp_min(1e-12)  # weight of a typical pixel
    angle = (inliers * squared).sum(dim=-1) / scale.clamp_min(1e-12)
    angle = (angle + _PRIOR_PIXELS * _PRIOR_ANGLE**2) / (effective + _PRIOR_PIXELS)
    # Compensates for the underestimated spread of few pixels.
    angle = angle * (1 + _PRIOR_PIXELS / effective.clamp_min(1.0))
    return start + step, (angle * scale)[..., None, None] * inverse


def _inverse_2x2(matrix: torch.Tensor) -> torch.Tensor:
    """Inverse of symmetric (..., 2, 2), positive definite."""
    a, b, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 1]
    determinant = (a * d - b * b).clamp_min(1e-12)
    adjugate = torch.stack([d, -b, -b, a], dim=-1) / determinant[..., None]
    return adjugate.unflatten(-1, (2, 2))


def _check_shapes(directions: torch.Tensor, weights: torch.Tensor) -> tuple[int, int, int, int]:
    if directions.ndim != 5 or directions.shape[2] != 2:
        raise InputError(f"directions must be (B, K, 2, H, W), got shape {tuple(directions.shape)}")
    batch, count, _, height, width = directions.shape
    if weights.shape != (batch, count, height, width):
        raise InputError(
            f"weights must be {(batch, count, height, width)} to match directions, "
            f"got shape {tuple(weights.shape)}"
        )
    return batch, count, height, width
