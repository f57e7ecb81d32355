"""``mid``: the pose from two (or more) views, fused in a volume of features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from .estimate import PoseEstimate, Roi
from .frontend import EncodedView, merge_votes
from .geometry import View, invert, make_transform, project, transform
from .single_view import SingleViewEstimator, first_view
from .soft_ransac import SoftRansacConfig, soft_ransac
from .symmetry import keypoint_permutations
from .triangulation import triangulate
from .volume import ViewMaps

SOLVER_INLIER = 0.2
"""Distance in diameters at which a keypoint counts half in Soft RANSAC."""

SOLVER_SHARPNESS = 4.0

_NEAREST = 0.1
"""Least depth in metres at which a region of interest is placed."""

_LEAST_PRIOR = 25.0
_LARGEST_PRIOR = 150.0


class MidFusionEstimator(SingleViewEstimator):
    """Mid-Fusion: every view's features, lifted into one volume around the object.

    With one view it answers as ``single`` does: that is the first pose of the environment.
    """

    def estimate(self, views: Sequence[View], object_name: str) -> PoseEstimate:
        index = self.index(object_name)
        reference = self.frontend.encode(first_view(views), index)
        first = self.from_one_view(reference, object_name)
        if len(views) == 1:
            return first
        encoded = [reference]
        for view in views[1:]:
            prior = expected_pixel(first, views[0], view)
            encoded.append(self.frontend.encode(view, index, prior))
        fused = self.fuse(encoded, object_name, first)
        again = self._look_again(encoded, object_name, fused)
        return replace(self.fuse(again, object_name, fused), rois=fused.rois)

    def _look_again(
        self, encoded: Sequence[EncodedView], object_name: str, fused: PoseEstimate
    ) -> list[EncodedView]:
        """Crops every view where a first fusion says the object is, and votes once more.

        The detector misjudges the size of a region by some ten percent; a fused pose does not.
        """
        model, index = self.networks.objects[object_name], self.index(object_name)
        permutations = keypoint_permutations(model.keypoints, model.symmetries)
        T_ref_world = encoded[0].view.T_cam_world
        views = []
        for first in encoded:
            T = first.view.T_cam_world @ invert(T_ref_world) @ fused.T_cam_obj
            depth = max(float(T[2, 3]), _NEAREST)
            centre = project(np.array([T[0, 3], T[1, 3], depth]), first.view.K)
            scale = self.networks.features.config.roi_scale
            side = scale * model.diameter * first.view.K[0, 0] / depth
            roi = Roi(centre=centre, side=side, score=first.roi.score)
            second = self.frontend.encode(first.view, index, roi=roi)
            views.append(merge_votes(second, first, permutations))
        return views

    def fuse(
        self, encoded: Sequence[EncodedView], object_name: str, first: PoseEstimate
    ) -> PoseEstimate:
        """Fuses encoded views, the reference first; ``first`` is the pose from the reference."""
        model = self.networks.objects[object_name]
        means = [e.vote_mean for e in encoded]
        covariances = [e.vote_covariance for e in encoded]
        guess = self._agree(encoded, means, covariances, object_name, first)
        T_ref_world = invert(encoded[0].view.T_cam_world)
        projections = [e.K_grid @ (e.view.T_cam_world @ T_ref_world)[:3] for e in encoded]
        diameter = torch.tensor([model.diameter], dtype=torch.float32)
        maps = ViewMaps(
            features=torch.stack([e.volume for e in encoded])[None],
            projection=torch.from_numpy(np.stack(projections)).float()[None],
            vote_mean=torch.from_numpy(np.stack(means)).float()[None],
            vote_covariance=torch.from_numpy(np.stack(covariances)).float()[None],
        )
        with torch.inference_mode():
            with torch.autocast("cpu", torch.bfloat16, enabled=self.frontend._bfloat16):
                levels = self.networks.volume(maps, torch.from_numpy(guess).float()[None], diameter)
            fine = levels[-1]
            solver = SoftRansacConfig.for_diameter(
                diameter, inlier=SOLVER_INLIER, sharpness=SOLVER_SHARPNESS
            )
            solution = soft_ransac(
                torch.from_numpy(model.keypoints).float(), fine.keypoints.float(), solver
            )
        T = make_transform(
            _orthonormal(solution.rotation[0].double().numpy()),
            solution.translation[0].double().numpy(),
        )
        return PoseEstimate(
            T_cam_obj=T,
            keypoints=fine.keypoints[0].double().numpy(),
            keypoint_covariance=fine.covariance[0].double().numpy(),
            rois=[e.roi for e in encoded],
        )

    def _agree(
        self,
        encoded: Sequence[EncodedView],
        means: list[np.ndarray],
        covariances: list[np.ndarray],
        object_name: str,
        first: PoseEstimate,
    ) -> np.ndarray:
        """Makes the views of a symmetric object mean the same pose, and guesses its centre (3,).

        Each view may have voted for another of the equivalent poses; a symmetry only renumbers the
        keypoints, so the numbering that triangulates best is taken (``means`` and ``covariances``
        are changed in place).
        """
        model = self.networks.objects[object_name]
        permutations = keypoint_permutations(model.keypoints, model.symmetries)
        Ks = [e.K_grid for e in encoded]
        cameras = [e.view.T_cam_world for e in encoded]
        T_ref_world = invert(cameras[0])
        points = np.empty((0, 3))
        for number in range(1, len(encoded)):
            best = np.inf
            chosen = np.arange(len(means[0]))
            for permutation in permutations:
                pair_means = np.stack([means[0], means[number][permutation]])
                pair_covariances = np.stack([covariances[0], covariances[number][permutation]])
                pair_K, pair_cameras = [Ks[0], Ks[number]], [cameras[0], cameras[number]]
                candidate, _ = triangulate(pair_means, pair_covariances, pair_K, pair_cameras)
                residual = 0.0
                for K, camera, mean in zip(pair_K, pair_cameras, pair_means, strict=True):
                    seen = transform(camera @ T_ref_world, candidate)
                    error = np.linalg.norm(project(seen, K) - mean, axis=1)
                    residual += float(np.minimum(error, 8.0).sum())
                if residual < best:
                    best, chosen, points = residual, permutation, candidate
            means[number] = means[number][chosen]
            covariances[number] = covariances[number][chosen]
        return self._centre(points, model.keypoints, model.diameter, first)

    @staticmethod
    def _centre(
        points: np.ndarray, keypoints: np.ndarray, diameter: float, first: PoseEstimate
    ) -> np.ndarray:
        """The object's centre from triangulated keypoints, as their pose would have it."""
        config = SoftRansacConfig.for_diameter(diameter, inlier=0.2, sharpness=8.0)
        solution = soft_ransac(
            torch.from_numpy(keypoints).float(), torch.from_numpy(points).float()[None], config
        )
        T = make_transform(solution.rotation[0].numpy(), solution.translation[0].numpy())
        centre = transform(T, keypoints[-1])
        if not np.isfinite(centre).all() or not 0.1 < centre[2] < 10:
            return first.keypoints[-1]
        return centre


def expected_pixel(first: PoseEstimate, reference: View, view: View) -> tuple[np.ndarray, float]:
    """Where another view should see the object's centre: pixel (2,) and standard deviation."""
    T_view_ref = view.T_cam_world @ invert(reference.T_cam_world)
    centre = transform(T_view_ref, first.keypoints[-1])
    depth = max(float(centre[2]), 0.1)
    pixel = project(np.array([centre[0], centre[1], depth]), view.K)
    spread = float(np.sqrt(np.linalg.eigvalsh(first.keypoint_covariance[-1])[-1]))
    sigma = float(np.clip(view.K[0, 0] * spread / depth, _LEAST_PRIOR, _LARGEST_PRIOR))
    return pixel, sigma


def _orthonormal(rotation: np.ndarray) -> np.ndarray:
    """Removes single precision's rounding from a rotation (3, 3)."""
    u, _, vt = np.linalg.svd(rotation)
    return u @ vt
