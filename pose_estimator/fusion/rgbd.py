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
from ..types import PoseEstimate, Roi
from .frontend import EncodedView
from .single import Request
from .two_view import Sighting, TwoViewEstimator


class RgbdEstimator(TwoViewEstimator):
    """Points of the depth map vote for the keypoints; further views are ignored.

    Like the fusions it has a second pass on a new crop. With too few points on the object it
    returns the result of ``single``.
    """

    def estimate_batch(
        self, requests: Sequence[Request], rois: Sequence[Sequence[Roi]] | None = None
    ) -> list[PoseEstimate]:
        self.targets(requests, rois)  # raises for all views what is wrong with any
        for views, _ in requests:
            if views[0].depth is None:
                raise InputError("rgbd needs the depth of the reference view (View.depth)")
        references = [(views[:1], name) for views, name in requests]
        sightings = self.encode_views(references, None if rois is None else [r[:1] for r in rois])
        first = self.fuse(sightings)
        answers = [sighting.first for sighting in sightings]
        seen = [n for n, pose in enumerate(first) if pose is not answers[n]]
        again = self.refine([replace(sightings[n], first=first[n]) for n in seen])
        for n, sighting, pose in zip(seen, again, self.fuse(again), strict=True):
            answers[n] = replace(pose, rois=sighting.first.rois)
        return answers

    def fuse(self, sightings: Sequence[Sighting]) -> list[PoseEstimate]:
        """Returns poses from the depth of encoded views; ``first`` where points are too few."""
        answers = [sighting.first for sighting in sightings]
        found = self.inference.in_batches(self._vote, sightings)
        for n, (sighting, votes) in enumerate(zip(sightings, found, strict=True)):
            if votes is not None:
                answers[n] = self.answer(sighting, *votes, weigh=False)
        return answers

    def _vote(self, sightings: Sequence[Sighting]) -> list[tuple[np.ndarray, np.ndarray] | None]:
        """Returns keypoints (9, 3) and covariances (9, 3, 3); None where points are too few."""
        tensor = self.inference.tensor
        references = [sighting.encoded[0] for sighting in sightings]
        crops = [self._crop_depth(reference) for reference in references]
        names = [sighting.object_name for sighting in sightings]
        diameter = tensor(np.array([self.networks.objects[name].diameter for name in names]))
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
        index = torch.tensor([self.index(name) for name in names], device=self.inference.device)
        votes = self.networks.points(maps, cloud, index, diameter)
        enough = (cloud.valid.sum(1) >= MIN_POINTS).tolist()
        parts = zip(as_array(votes.keypoints), as_array(votes.covariance), strict=True)
        return [part if known else None for known, part in zip(enough, parts, strict=True)]

    def _crop_depth(self, reference: EncodedView) -> tuple[np.ndarray, np.ndarray]:
        """Returns the depth of a view's crop, (S, S) m, and the crop's camera (3, 3)."""
        config = self.networks.features.config
        to_crop = np.linalg.inv(reference.to_image @ grid_matrix(config.stride))
        assert reference.view.depth is not None
        depth = cv2.warpAffine(
            reference.view.depth, to_crop[:2], (config.crop, config.crop), flags=cv2.INTER_NEAREST
        )
        return depth, to_crop @ reference.view.K
