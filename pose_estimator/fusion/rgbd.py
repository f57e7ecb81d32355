"""``rgbd``: the pose from one image and its depth map, the study's reference method."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch

from ...core.errors import InputError
from ...core.geometry import grid_matrix
from ..networks.inference import as_array
from ..networks.point_cloud import MIN_POINTS, sample_points
from ..networks.point_voting import PointMaps, point_features
from ..types import DepthUse, PoseEstimate, Roi
from .estimator import KeypointEstimator, Request, Sighting
from .frontend import EncodedView, Target
from .one_view import solve_one_view


class RgbdEstimator(KeypointEstimator):
    """Points of the depth map vote for the keypoints; further views are ignored.

    With too few points on the object it returns the result of ``single``; ``depth_use`` tells.
    """

    reference_only = True

    def targets(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None
    ) -> list[list[Target]]:
        found = super().targets(requests, rois)
        for views, _ in requests:
            if views[0].depth is None:
                raise InputError("rgbd needs the depth of the reference view (View.depth)")
        return found

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        answers = []
        votes = self.inference.in_batches(self._vote, sightings)
        for sighting, (use, *vote) in zip(sightings, votes, strict=True):
            if use.points < MIN_POINTS:
                answer = solve_one_view(sighting.encoded[0], sighting.model, self.roi_scale)
            else:
                answer = self.answer(sighting, *vote)
            answers.append(replace(answer, depth_use=use))
        return answers

    def _vote(self, sightings: Sequence[Sighting]) -> list[tuple[DepthUse, np.ndarray, np.ndarray]]:
        """Returns what depth shows, and keypoints (9, 3) with covariances (9, 3, 3) from it."""
        tensor = self.inference.tensor
        references = [sighting.encoded[0] for sighting in sightings]
        crops = [self._crop_depth(reference) for reference in references]
        diameter = tensor(np.array([sighting.model.diameter for sighting in sightings]))
        mask = tensor(np.stack([r.mask for r in references]))
        cloud = sample_points(
            tensor(np.stack([depth for depth, _ in crops])),
            mask,
            tensor(np.stack([K for _, K in crops])),
            diameter,
            self.networks.points.config.points,
            [torch.Generator("cpu").manual_seed(0) for _ in sightings],
        )
        decoder = torch.stack([r.decoder for r in references])
        maps = PointMaps(
            features=point_features(decoder, mask),
            vote_mean=tensor(np.stack([r.vote_mean for r in references])),
            vote_covariance=tensor(np.stack([r.vote_covariance for r in references])),
            K_grid=tensor(np.stack([r.K_grid for r in references])),
        )
        index = torch.tensor([s.index for s in sightings], device=self.inference.device)
        votes = self.networks.points(maps, cloud, index, diameter)
        shown = zip(sightings, cloud.valid.sum(1).tolist(), crops, strict=True)
        uses = [_depth_use(sighting, points, depth) for sighting, points, (depth, _) in shown]
        return list(zip(uses, as_array(votes.keypoints), as_array(votes.covariance), strict=True))

    def _crop_depth(self, reference: EncodedView) -> tuple[np.ndarray, np.ndarray]:
        """Returns the depth of a view's crop, (S, S) m, and the crop's camera (3, 3)."""
        config = self.networks.features.config
        to_crop = np.linalg.inv(reference.to_image @ grid_matrix(config.stride))
        assert reference.view.depth is not None
        depth = cv2.warpAffine(
            reference.view.depth, to_crop[:2], (config.crop, config.crop), flags=cv2.INTER_NEAREST
        )
        return depth, to_crop @ reference.view.K


def _depth_use(sighting: Sighting, points: int, depth: np.ndarray) -> DepthUse:
    """Returns what the depth (S, S) of the reference view's crop shows."""
    mask = sighting.encoded[0].mask.astype(np.float32)
    inside = depth[cv2.resize(mask, depth.shape[::-1]) > 0.5]
    known = inside[inside > 0]
    return DepthUse(
        points=points,
        share=known.size / max(1, inside.size),
        distance=float(np.median(known)) if known.size else None,
        expected=float(sighting.first.T_cam_obj[2, 3]),
    )
