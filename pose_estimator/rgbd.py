"""``rgbd``: the pose from one picture and a depth sensor's map of it, the study's reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch

from .estimate import PoseEstimate, Roi
from .frontend import EncodedView
from .geometry import View, grid_matrix
from .inference import Run
from .point_cloud import LEAST_POINTS, sample_points
from .point_voting import PointMaps, PointVotes, point_features
from .single_view import check_rois, first_view
from .two_view import TwoViewEstimator


class RgbdEstimator(TwoViewEstimator):
    """Points of the sensor's depth vote for the keypoints; further views are ignored.

    Like the fusions of views it looks twice: the first pose crops the picture anew. Where the
    sensor sees next to nothing of the object, it answers as ``single`` does.
    """

    def estimate(
        self, views: Sequence[View], object_name: str, rois: Sequence[Roi] | None = None
    ) -> PoseEstimate:
        if first_view(views).depth is None:
            raise ValueError(
                "rgbd needs the depth of the reference view: give View.depth, a map (height, "
                "width) of metres, or use a method that needs none"
            )
        given = None if rois is None else check_rois(rois, views)[:1]
        encoded, single = self.encode_views(views[:1], object_name, given)
        first = self.fuse(encoded, object_name, single)
        if first is single:
            return single
        again = self.look_again(encoded, object_name, first)
        return replace(self.fuse(again, object_name, first), rois=first.rois)

    def fuse(
        self, encoded: Sequence[EncodedView], object_name: str, first: PoseEstimate
    ) -> PoseEstimate:
        """The pose from the depth of an encoded view; ``first`` if it shows too few points."""
        model, (reference,) = self.networks.objects[object_name], encoded
        config = self.networks.features.config
        to_crop = np.linalg.inv(reference.to_image @ grid_matrix(config.stride))
        assert reference.view.depth is not None and reference.decoder is not None
        depth = cv2.warpAffine(
            reference.view.depth, to_crop[:2], (config.crop, config.crop), flags=cv2.INTER_NEAREST
        )
        mask = torch.from_numpy(reference.mask).float()[None]
        diameter = torch.tensor([model.diameter], dtype=torch.float32)
        with torch.inference_mode():
            cloud = sample_points(
                torch.from_numpy(depth)[None],
                mask,
                torch.from_numpy(to_crop @ reference.view.K).float()[None],
                diameter,
                self.networks.points.config.points,
                torch.Generator().manual_seed(0),
            )
            if int(cloud.valid.sum()) < LEAST_POINTS:
                return first
            maps = PointMaps(
                features=point_features(reference.decoder[None], mask),
                vote_mean=torch.from_numpy(reference.vote_mean).float()[None],
                vote_covariance=torch.from_numpy(reference.vote_covariance).float()[None],
                K_grid=torch.from_numpy(reference.K_grid).float()[None],
            )
            index = torch.tensor([self.index(object_name)])
        votes: PointVotes = self.ask(
            Run(lambda: self.networks.points(maps, cloud, index, diameter))
        )
        keypoints = votes.keypoints[0].double().numpy()
        covariance = votes.covariance[0].double().numpy()
        return self.answer(encoded, object_name, keypoints, covariance, weigh=False)
