"""``early``: a depth map from two views, which gives the voted keypoints their depth.

As in the paper, a keypoint inside or behind the object gets the depth of the surface in front of
it. Its distance behind that surface in the pose so far widens its covariance, which is reported and
which ``--refine votes`` relies on; the solver takes all keypoints alike.
"""

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
from .estimator import KeypointEstimator, Sighting
from .frontend import EncodedView

_MIN_MASK = 0.5
"""Probability of the object from which a pixel's depth is read."""

_PIXEL_DEVIATION = 0.5
"""Standard deviation in pixels of the depth map, added to every vote."""

_SAME_SURFACE = 0.01
"""Meters from the median within which depths are averaged; others belong to another surface."""

_MAX_SURFACE_OFFSET = 0.03
"""Meters: the distance of another surface is clipped here; at the rim it may be far behind."""

_FOOTPRINT = 0.03
"""Radius in diameters of the surface patch in front of a keypoint."""


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


class EarlyFusionEstimator(KeypointEstimator):
    """Early Fusion: a cascade cost volume over the views, and votes of the reference view."""

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        sweeps = [(s.encoded, float(s.joint.keypoints[-1, 2]), s.model.diameter) for s in sightings]
        maps = self.depth_maps(sweeps)
        return [self._read(s, found) for s, found in zip(sightings, maps, strict=True)]

    def depth_maps(
        self, sweeps: Sequence[tuple[Sequence[EncodedView], float, float]]
    ) -> list[DepthMap]:
        """Computes depth maps of reference crops, by the last stage of the cascade.

        Args:
            sweeps: for each, two or more views, the reference first; the depth of the object's
                center in the reference camera, m; and its diameter, m.
        """

        def run(sweeps: Sequence[tuple[Sequence[EncodedView], float, float]]) -> list[DepthMap]:
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

        return self.inference.in_batches(run, sweeps, lambda sweep: len(sweep[0]))

    def _cascade_views(self, encoded: Sequence[EncodedView]) -> CascadeViews:
        """Returns the cascade's input, a batch of one."""
        T_ref_world = invert(encoded[0].view.T_cam_world)
        to_crop = np.linalg.inv(grid_matrix(self.networks.features.config.stride))
        levels = zip(*(e.maps[:4] for e in encoded), strict=True)
        poses = np.stack([e.view.T_cam_world @ T_ref_world for e in encoded])
        return CascadeViews(
            maps=tuple(torch.stack(level)[None] for level in levels),
            K=self.inference.tensor(np.stack([to_crop @ e.K_grid for e in encoded])[None]),
            T_view_ref=self.inference.tensor(poses[None]),
        )

    def _read(self, sighting: Sighting, found: DepthMap) -> PoseEstimate:
        """Solves for the pose from the depth map at the reference's votes."""
        reference = sighting.encoded[0]
        to_grid = grid_matrix(self.networks.features.config.stride)
        to_map = grid_matrix(found.stride) @ np.linalg.inv(to_grid)
        K_map = to_map @ reference.K_grid
        A = to_map[:2, :2]
        votes = reference.vote_mean @ A.T + to_map[:2, 2]
        vote_covariance = A @ reference.vote_covariance @ A.T
        depth, variance = read_depth(
            found.depth, found.variance, reference.mask, votes, vote_covariance, K_map
        )
        variance = variance + behind_surface(sighting.model, sighting.joint.T_cam_obj) ** 2
        keypoints, covariance = back_project(votes, vote_covariance, depth, variance, K_map)
        return self.answer(sighting, keypoints, covariance)


def read_depth(
    depth: np.ndarray,
    variance: np.ndarray,
    mask: np.ndarray,
    votes: np.ndarray,
    vote_covariance: np.ndarray,
    K: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Reads a depth map at voted keypoints.

    A keypoint's depth is the mean over the object's pixels, weighted by the likelihood of the vote:
    it interpolates for a sharp vote, and takes the object's nearest pixels for one outside. Depths
    far from the median belong to other surfaces and are left out.

    Args:
        depth: (H, W), m.
        variance: of the depths, (H, W), m^2.
        mask: (G, G) probability of the object, on any grid over the same crop; where no pixel is
            likely, all are read.
        votes: (9, 2), pixels of the map.
        vote_covariance: (9, 2, 2).
        K: (3, 3) camera of the map.

    Returns:
        Depths (9,) in meters, and their variances (9,): those of the map, of the depths around,
        and the squared distance of the pixels from the vote.
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
    deviation = np.minimum(np.abs(z - mean[:, None]), _MAX_SURFACE_OFFSET)
    around = (weight * (spread + deviation**2)).sum(1)
    # Even a sharp vote is half a pixel from its neighbors.
    away = np.linalg.norm(np.einsum("kn,kni->ki", weight, offset), axis=1)
    pixel = mean / np.sqrt(abs(np.linalg.det(K[:2, :2])))
    return mean, around + (np.maximum(away - _PIXEL_DEVIATION, 0) * pixel) ** 2


def back_project(
    pixels: np.ndarray,
    pixel_covariance: np.ndarray,
    depth: np.ndarray,
    variance: np.ndarray,
    K: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Returns points (N, 3) and covariances (N, 3, 3) of pixels (N, 2) with depths (N,)."""
    back = np.linalg.inv(K)
    rays = np.concatenate([pixels, np.ones((len(pixels), 1))], 1) @ back.T
    across = depth[:, None, None] * back[:, :2]
    covariance = across @ pixel_covariance @ across.transpose(0, 2, 1)
    along = rays[:, :, None] * rays[:, None, :] * variance[:, None, None]
    return depth[:, None] * rays, covariance + along


def behind_surface(model: ObjectModel, T_cam_obj: np.ndarray) -> np.ndarray:
    """Returns how far each keypoint lies behind the object's front, (9,) m, at least 0."""
    points = transform(T_cam_obj, model.points)
    keypoints = transform(T_cam_obj, model.keypoints)
    depth = np.maximum(points[:, 2], 1e-3)
    middle = max(float(keypoints[-1, 2]), 1e-3)
    across = points[:, :2] / depth[:, None]
    wanted = keypoints[:, :2] / np.maximum(keypoints[:, 2:], 1e-3)
    distance = middle * np.linalg.norm(across - wanted[:, None], axis=-1)
    # Points are sparse: the patch has at least the nearest four.
    radius = np.maximum(_FOOTPRINT * model.diameter, np.sort(distance, 1)[:, 3])
    front = np.where(distance <= radius[:, None], points[:, 2], np.inf).min(1)
    return np.maximum(keypoints[:, 2] - front, 0.0)
