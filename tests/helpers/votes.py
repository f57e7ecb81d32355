"""Stands in for the 2D networks: perfect, symmetric and random votes of a known scene."""

import numpy as np
import torch
from two_view_pose.core.geometry import (
    LINEMOD_K,
    View,
    crop_matrix,
    grid_matrix,
    make_transform,
    project,
    transform,
)
from two_view_pose.pose_estimator.evaluation.metrics import add_or_add_s
from two_view_pose.pose_estimator.fusion.frontend import EncodedView
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.types import PoseEstimate, Roi

T_WORLD_OBJ = make_transform(
    np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]]), np.array([0.03, -0.02, 0.01])
)


def camera(degrees: float) -> np.ndarray:
    """T_cam_world of a camera on a circle around the world's origin, looking down at it."""
    azimuth, elevation = np.radians([degrees, 50.0])
    flat = np.cos(elevation)
    out = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    right = np.cross(-out, (0, 0, 1)) / flat
    return make_transform(np.stack([right, np.cross(-out, right), -out]), np.array([0, 0, 0.9]))


def view(degrees: float) -> View:
    return View(np.zeros((480, 640, 3), np.uint8), LINEMOD_K, camera(degrees))


class PerfectVotes:
    """Votes from the ground truth; records the given ROIs.

    ``twist`` has the index of the symmetry that each call votes for.
    """

    def __init__(self, networks: PoseNetworks, twist: tuple[int, ...] = (), noise: float = 0.0):
        self.networks = networks
        self.twist = twist
        self.rng = np.random.default_rng(0)
        self.noise = noise
        self.calls = 0
        self.rois: list[Roi | None] = []

    def regions(self, requests) -> list[list[Roi | None]]:
        return [[None] * len(views) for views, _ in requests]

    def encode(self, targets) -> list[EncodedView]:
        return [self.encode_view(*target) for target in targets]

    def encode_view(self, view, index, roi=None) -> EncodedView:
        model = list(self.networks.objects.values())[index]
        symmetry = self.twist[self.calls % len(self.twist)] if self.twist else 0
        self.calls += 1
        self.rois.append(roi)
        T = view.T_cam_world @ T_WORLD_OBJ @ model.symmetries[symmetry]
        config = self.networks.features.config
        side = 1.4 * model.diameter * view.K[0, 0] / T[2, 3]
        found = roi or Roi(project(T[:3, 3], view.K) + np.array([4, -3]), side, 0.9)
        to_crop = crop_matrix(found.center, found.side, config.crop)
        to_grid = grid_matrix(config.stride) @ to_crop
        votes = project(transform(T, model.keypoints), to_grid @ view.K)
        return EncodedView(
            view=view,
            roi=found,
            K_grid=to_grid @ view.K,
            to_image=np.linalg.inv(to_grid),
            volume=torch.zeros(config.volume_channels, config.grid, config.grid),
            decoder=torch.zeros(config.width, config.grid, config.grid),
            maps=(),
            vote_mean=votes + self.rng.normal(0, 1, votes.shape) * self.noise,
            vote_covariance=np.tile(np.eye(2) * max(self.noise, 0.2) ** 2, (9, 1, 1)),
            vote_score=np.ones(9),
            mask=np.ones((config.grid, config.grid)),
        )

    def encode_rotated(self, targets, rolls) -> list[list[EncodedView]]:
        return [[self.encode_view(*t)] * len(own) for t, own in zip(targets, rolls, strict=True)]


class Garbage(PerfectVotes):
    """Votes anywhere, with any confidence."""

    def encode_view(self, view, index, roi=None) -> EncodedView:
        good = super().encode_view(view, index)
        scale = 10.0 ** self.rng.uniform(-2, 5)
        object.__setattr__(good, "vote_mean", self.rng.normal(16, scale, (9, 2)))
        covariance = np.tile(np.eye(2) * 10.0 ** self.rng.uniform(-3, 5), (9, 1, 1))
        object.__setattr__(good, "vote_covariance", covariance)
        return good


def error(found: PoseEstimate, networks: PoseNetworks, name: str, degrees: float) -> float:
    """ADD(-S) in diameters."""
    model = networks.objects[name]
    return add_or_add_s(found.T_cam_obj, camera(degrees) @ T_WORLD_OBJ, model) / model.diameter


def check_sound(found: PoseEstimate, views: int) -> None:
    T = found.T_cam_obj
    assert T.dtype == np.float64 and np.isfinite(T).all()
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(T[:3, :3]) > 0 and np.array_equal(T[3], [0, 0, 0, 1])
    assert found.keypoints.shape == (9, 3) and np.isfinite(found.keypoints).all()
    assert found.keypoint_covariance.shape == (9, 3, 3)
    assert np.isfinite(found.keypoint_covariance).all()
    assert len(found.rois) == views
