"""``early``: two views become a depth map first, and keypoints take the depth where they are voted.

What a depth map knows is the surface. A keypoint on the far side of the object, or inside it, gets
the depth of the surface in front of it, as in the paper; how far it should lie behind that surface
in the pose so far only widens its covariance, so that the solver leans on the keypoints that the
reference view can see.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch

from ...assets.object_model import ObjectModel
from ...core.geometry import grid_matrix, invert, transform
from ..networks.cascade import CascadeViews
from ..networks.inference import as_array
from ..types import PoseEstimate
from .frontend import EncodedView
from .symmetry_agreement import joint_pose, resolve_symmetry_ambiguity
from .two_view import Sighting, TwoViewEstimator

_MIN_MASK = 0.5
"""Probability of the object from which a pixel's depth is read."""

_PIXEL_DEVIATION = 0.5
"""Standard deviation in pixels of the depth map that is added to every vote."""

_SAME_SURFACE = 0.01
"""Meters from the median within which depths are averaged; others are another surface."""

_MAX_SURFACE_OFFSET = 0.03
"""Meters that another surface counts as at most: at the object's rim it may be far behind, and no
keypoint is there."""

_FOOTPRINT = 0.03
"""Radius in diameters of the spot of surface that is taken to lie in front of a keypoint."""


class DepthMap(NamedTuple):
    """The depth of a crop.

    Attributes:
        depth: (H, W), m.
        variance: of the depths, (H, W), m^2.
        stride: pixels of the crop per pixel of the map.
    """

    depth: np.ndarray
    variance: np.ndarray
    stride: int


class EarlyFusionEstimator(TwoViewEstimator):
    """Early Fusion: views meet in a cascade cost volume, the votes are the reference view's."""

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        sweeps = []
        for sighting in sightings:
            model = self.networks.objects[sighting.object_name]
            agreed, points = resolve_symmetry_ambiguity(sighting.encoded, model)
            joint = joint_pose(agreed, points, model, sighting.first)
            center = transform(joint, model.keypoints[-1])
            sweeps.append((sighting.encoded, float(center[2]), model.diameter))
        maps = self.depth_maps(sweeps)
        return [self._read(s, found) for s, found in zip(sightings, maps, strict=True)]

    def depth_maps(
        self, sweeps: Sequence[tuple[Sequence[EncodedView], float, float]]
    ) -> list[DepthMap]:
        """The depth of reference crops.

        Args:
            sweeps: of each two views or more, the reference first; the depth of the object's center
                in the reference camera, m; and its diameter, m.

        Returns:
            What the last stage of the cascade says of each.
        """

        def look(sweeps: Sequence[tuple[Sequence[EncodedView], float, float]]) -> list[DepthMap]:
            views = [self._cascade_views(encoded) for encoded, _, _ in sweeps]
            levels = zip(*(v.maps for v in views), strict=True)
            last = self.networks.cascade(
                CascadeViews(
                    maps=tuple(torch.cat(level) for level in levels),
                    K=torch.cat([v.K for v in views]),
                    T_view_ref=torch.cat([v.T_view_ref for v in views]),
                ),
                self.inference.tensor(np.array([guess for _, guess, _ in sweeps])),
                self.inference.tensor(np.array([diameter for _, _, diameter in sweeps])),
            )[-1]
            parts = zip(as_array(last.depth), as_array(last.variance), strict=True)
            return [DepthMap(depth, variance, last.stride) for depth, variance in parts]

        return self.inference.in_batches(look, sweeps, lambda sweep: len(sweep[0]))

    def _cascade_views(self, encoded: Sequence[EncodedView]) -> CascadeViews:
        """What the views bring to the cascade, a batch of one."""
        T_ref_world = invert(encoded[0].view.T_cam_world)
        to_crop = np.linalg.inv(self._to_grid())
        levels = zip(*(e.maps[:4] for e in encoded), strict=True)
        poses = np.stack([e.view.T_cam_world @ T_ref_world for e in encoded])
        return CascadeViews(
            maps=tuple(torch.stack(level)[None] for level in levels),
            K=self.inference.tensor(np.stack([to_crop @ e.K_grid for e in encoded])[None]),
            T_view_ref=self.inference.tensor(poses[None]),
        )

    def _read(self, sighting: Sighting, found: DepthMap) -> PoseEstimate:
        """The pose from a depth map, where the reference's votes are."""
        model = self.networks.objects[sighting.object_name]
        reference = sighting.encoded[0]
        to_map = grid_matrix(found.stride) @ np.linalg.inv(self._to_grid())
        K_map = to_map @ reference.K_grid
        A = to_map[:2, :2]
        votes = reference.vote_mean @ A.T + to_map[:2, 2]
        vote_covariance = A @ reference.vote_covariance @ A.T
        depth, variance = read_depth(
            found.depth, found.variance, reference.mask, votes, vote_covariance, K_map
        )
        variance = variance + behind_surface(model, sighting.first.T_cam_obj) ** 2
        keypoints, covariance = back_project(votes, vote_covariance, depth, variance, K_map)
        return self.answer(sighting, keypoints, covariance, weigh=True)

    def _to_grid(self) -> np.ndarray:
        return grid_matrix(self.networks.features.config.stride)


def read_depth(
    depth: np.ndarray,
    variance: np.ndarray,
    mask: np.ndarray,
    votes: np.ndarray,
    vote_covariance: np.ndarray,
    K: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The depth that a map has where keypoints were voted.

    A keypoint reads all pixels of the object, each by how likely it is to be the voted one: where
    the vote is sharp that interpolates between its neighbors, and where it lies beside the object
    it is the object's nearest pixels that count. Depths far from the median belong to other
    surfaces, and are left out of the mean.

    Args:
        depth: (H, W), m.
        variance: of the depths, (H, W), m^2.
        mask: (G, G) probability of the object, on any grid over the same crop. Where nothing is
            likely to be the object, all pixels are read.
        votes: (9, 2), pixels of the map.
        vote_covariance: (9, 2, 2).
        K: (3, 3) camera of the map.

    Returns:
        Depths (9,) in meters, and their variances (9,): the map's own, that of the depths around
        (as far as another surface counts), and the square of how far the pixels that were read are
        from the vote.
    """
    height, width = depth.shape
    inside = cv2.resize(np.asarray(mask, np.float32), (width, height)).ravel() > _MIN_MASK
    if not inside.any():
        inside[:] = True
    v, u = np.divmod(np.flatnonzero(inside), width)
    pixels = np.stack([u, v], -1).astype(np.float64)
    z, spread = depth.ravel()[inside], variance.ravel()[inside]
    precision = np.linalg.inv(vote_covariance + _PIXEL_DEVIATION**2 * np.eye(2))
    offset = pixels - votes[:, None]
    distance = np.einsum("kni,kij,knj->kn", offset, precision, offset)
    weight = np.exp(-0.5 * (distance - distance.min(1, keepdims=True)))
    weight /= weight.sum(1, keepdims=True)

    order = np.argsort(z)
    middle = (weight[:, order].cumsum(1) < 0.5).sum(1).clip(max=len(z) - 1)
    median = z[order][middle]
    near = weight * (np.abs(z - median[:, None]) <= _SAME_SURFACE)
    mean = (near * z).sum(1) / near.sum(1)
    doubt = np.minimum(np.abs(z - mean[:, None]), _MAX_SURFACE_OFFSET)
    around = (weight * (spread + doubt**2)).sum(1)
    # A sharp vote is half a pixel from its neighbors anyway.
    beside = np.linalg.norm(np.einsum("kn,kni->ki", weight, offset), axis=1)
    pixel = mean / np.sqrt(abs(np.linalg.det(K[:2, :2])))
    return mean, around + (np.maximum(beside - _PIXEL_DEVIATION, 0) * pixel) ** 2


def back_project(
    pixels: np.ndarray,
    pixel_covariance: np.ndarray,
    depth: np.ndarray,
    variance: np.ndarray,
    K: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) and their covariances (N, 3, 3) from pixels (N, 2) and depths (N,)."""
    back = np.linalg.inv(K)
    rays = np.concatenate([pixels, np.ones((len(pixels), 1))], 1) @ back.T
    across = depth[:, None, None] * back[:, :2]
    covariance = across @ pixel_covariance @ across.transpose(0, 2, 1)
    along = rays[:, :, None] * rays[:, None, :] * variance[:, None, None]
    return depth[:, None] * rays, covariance + along


def behind_surface(model: ObjectModel, T_cam_obj: np.ndarray) -> np.ndarray:
    """How far behind the object's front each keypoint lies in a pose, (9,) m, not negative."""
    points = transform(T_cam_obj, model.points)
    keypoints = transform(T_cam_obj, model.keypoints)
    depth = np.maximum(points[:, 2], 1e-3)
    middle = max(float(keypoints[-1, 2]), 1e-3)
    across = points[:, :2] / depth[:, None]
    wanted = keypoints[:, :2] / np.maximum(keypoints[:, 2:], 1e-3)
    distance = middle * np.linalg.norm(across - wanted[:, None], axis=-1)
    # Points are sparse: at least the nearest few are the spot.
    radius = np.maximum(_FOOTPRINT * model.diameter, np.sort(distance, 1)[:, 3])
    front = np.where(distance <= radius[:, None], points[:, 2], np.inf).min(1)
    return np.maximum(keypoints[:, 2] - front, 0.0)
