"""Associates detections of an object across views by their position in space.

Each view's heat map has several peaks, and a distractor may score higher than the occluded object
in one of them. Peaks of two views match if one point in space explains both: their rays meet at a
depth that fits the sizes of both regions.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...core.geometry import View, invert, project, transform
from ..types import Roi, depth_of_roi

_SCALE_STD = 0.3
"""Standard deviation of the logarithm of a region's side."""

_CENTER_STD = 0.12
"""Standard deviation of a region's center in sides of the region."""

_MAX_COST = 16.0
"""Squared deviations are clipped here: the two regions do not match."""

_DEPTHS = np.exp(np.linspace(-0.8, 0.8, 65))
"""Depths along a ray, relative to the depth from the region's size."""


def associate_detections(
    candidates: Sequence[Sequence[Roi]], views: Sequence[View], diameter: float, scale: float
) -> list[int]:
    """Picks one candidate of each view, so that scores are high and positions consistent.

    Args:
        candidates: regions of each view, at least one.
        views: the reference first; their cameras are known.
        diameter: of the object, meters.
        scale: side of a region in diameters.

    Returns:
        The index of the candidate in each view.
    """
    first, *others = candidates
    total = np.log(np.maximum([roi.score for roi in first], 1e-6))
    partners = []
    for regions, view in zip(others, views[1:], strict=True):
        deviations, _ = association_costs(first, regions, views[0], view, diameter, scale)
        scores = np.log(np.maximum([roi.score for roi in regions], 1e-6))
        agreement = scores - 0.5 * deviations.min(axis=-1)
        partners.append(agreement.argmax(axis=1))
        total = total + agreement.max(axis=1)
    best = int(np.argmax(total))
    return [best, *(int(chosen[best]) for chosen in partners)]


def refine_roi_scales(
    regions: Sequence[Roi], views: Sequence[View], diameter: float, scale: float
) -> list[Roi]:
    """Corrects the sides of regions by the depth at which the rays of their centers meet.

    The detector's sides are a tenth off, and more on images unlike its training data; triangulated
    centers are better: on Linemod-Occluded, sides were 12 percent off before and 3 after.

    Args:
        regions: one for each view; the other arguments are as above.

    Returns:
        A region for each view, unchanged where it does not match the reference's.
    """
    first, *others = regions
    pairs = [
        association_costs([first], [other], views[0], view, diameter, scale)
        for other, view in zip(others, views[1:], strict=True)
    ]
    best = int(np.sum([deviations for deviations, _ in pairs], axis=0).argmin()) if pairs else 0
    sized, agreed = [], False
    for other, view, (deviations, depths) in zip(others, views[1:], pairs, strict=True):
        agrees = deviations[0, 0, best] < _MAX_COST
        agreed |= bool(agrees)
        side = scale * diameter * float(view.K[0, 0]) / depths[0, best]
        sized.append(replace(other, side=side) if agrees else other)
    return [replace(first, side=first.side / _DEPTHS[best]) if agreed else first, *sized]


def association_costs(
    firsts: Sequence[Roi],
    seconds: Sequence[Roi],
    view: View,
    other: View,
    diameter: float,
    scale: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Computes how badly one point explains two regions, at depths along the first's ray.

    Args:
        firsts, seconds: A regions of ``view`` and B regions of ``other``.
        view, other: images and cameras.
        diameter, scale: as above.

    Returns:
        Sums of squared deviations (A, B, D) at each of ``_DEPTHS``, 16 at most; and the depths
        (A, D) in the other camera, meters.
    """
    expected = np.array([depth_of_roi(roi, view.K, diameter, scale) for roi in firsts])
    rays = np.array([(*roi.center, 1.0) for roi in firsts]) @ np.linalg.inv(view.K).T
    points = (expected[:, None] * _DEPTHS)[..., None] * rays[:, None]
    seen = transform(other.T_cam_world @ invert(view.T_cam_world), points)
    before = seen[..., 2] > 0.05
    # Points behind the camera are moved in front of it, and masked in the end.
    safe = np.where(before[..., None], seen, (0.0, 0.0, 1.0))
    pixels = project(safe, other.K)
    centers = np.array([roi.center for roi in seconds])
    sides = np.array([roi.side for roi in seconds])
    depths = np.array([depth_of_roi(roi, other.K, diameter, scale) for roi in seconds])
    # Both centers are uncertain; the first's deviation is taken at the second's size.
    off = pixels[:, None] - centers[:, None]
    off /= (np.sqrt(2) * _CENTER_STD * sides)[:, None, None]
    deviations = (
        (off**2).sum(-1)
        + (np.log(_DEPTHS) / _SCALE_STD) ** 2
        + (np.log(safe[:, None, :, 2] / depths[:, None]) / _SCALE_STD) ** 2
    )
    deviations = np.minimum(deviations, _MAX_COST)
    return np.where(before[:, None], deviations, _MAX_COST), seen[..., 2]
