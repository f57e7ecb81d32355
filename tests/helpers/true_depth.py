"""Stands in for the cascade of ``early``, with the maps and masks that it needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from helpers.boxes import box_depth
from helpers.votes import T_WORLD_OBJ, PerfectVotes
from torch import nn
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import grid_matrix
from two_view_pose.pose_estimator.networks.cascade import CascadeConfig, DepthOutput
from two_view_pose.pose_estimator.networks.encoder import PYRAMID_CHANNELS


class TrueDepth(nn.Module):
    """Stands in for the cascade: the depth of one box in front of a far background."""

    def __init__(self, model: ObjectModel, T_ref_obj: np.ndarray):
        super().__init__()
        self.model = model
        self.T_ref_obj = T_ref_obj
        self.config = CascadeConfig()
        self.seen = []

    def forward(self, views, guess, diameter):
        self.seen.append((views, guess))
        stride = 2
        K = grid_matrix(stride) @ views.K[0, 0].double().numpy()
        depth = torch.from_numpy(box_depth(self.model, self.T_ref_obj, K, (64, 64)))[None]
        depth = torch.where(depth > 0, depth, torch.tensor(1.2))
        return [DepthOutput(depth, torch.full_like(depth, 1e-6), depth, torch.ones(1), stride)]


def with_masks_and_maps(frontend: PerfectVotes, model: ObjectModel) -> PerfectVotes:
    """The frontend, with an encoder's maps and the mask of a box in its views."""
    encode = frontend.encode_view
    generator = torch.Generator().manual_seed(0)

    def encode_view(*arguments, **options):
        shapes = zip(PYRAMID_CHANNELS, (64, 32, 16, 8, 4), strict=True)
        maps = tuple(torch.rand(c, side, side, generator=generator) for c, side in shapes)
        encoded = encode(*arguments, **options)
        T = encoded.view.T_cam_world @ T_WORLD_OBJ
        mask = box_depth(model, T, encoded.K_grid, (32, 32)) > 0
        return replace(encoded, maps=maps, mask=mask.astype(np.float32))

    frontend.encode_view = encode_view
    return frontend
