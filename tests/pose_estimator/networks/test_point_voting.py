"""Votes of points: the robust mean, and invariances of the network."""

import numpy as np
import pytest
import torch
from two_view_pose.core.geometry import project
from two_view_pose.pose_estimator.networks.point_cloud import PointCloud, crop_frame
from two_view_pose.pose_estimator.networks.point_voting import (
    PointConfig,
    PointMaps,
    PointVotingNet,
    robust_mean,
)

DIAMETER = torch.tensor([0.2, 0.1])
POINTS = 40


def truth_and_votes(spread: float, seed: int = 0):
    rng = np.random.default_rng(seed)
    truth = rng.normal(0, 0.05, (2, 9, 3))
    return truth, truth[:, None] + rng.normal(0, spread, (2, POINTS, 9, 3))


def averaged(votes, log_error=None, valid=None):
    votes = torch.from_numpy(votes)
    log_error = torch.zeros(votes.shape[:3]) if log_error is None else log_error
    valid = torch.ones(votes.shape[:2], dtype=torch.bool) if valid is None else valid
    mean, covariance = robust_mean(votes, log_error.double(), valid, DIAMETER.double())
    return mean.numpy(), covariance.numpy()


def test_consistent_votes_are_averaged():
    _, votes = truth_and_votes(spread=1e-4)
    mean, covariance = averaged(votes)
    np.testing.assert_allclose(mean, votes.mean(1), atol=1e-6)
    for b, k in ((0, 0), (1, 8)):
        expected = np.cov(votes[b, :, k].T, bias=True)
        np.testing.assert_allclose(covariance[b, k], expected, rtol=1e-3, atol=1e-12)


def test_votes_are_weighted_by_inverse_squared_errors():
    _, votes = truth_and_votes(spread=1e-4)
    log_error = torch.zeros(2, POINTS, 9)
    log_error[:, ::2] = float(np.log(0.1))
    mean, _ = averaged(votes, log_error)
    weights = np.where(np.arange(POINTS) % 2 == 0, 100.0, 1.0)
    np.testing.assert_allclose(mean, np.average(votes, axis=1, weights=weights), atol=1e-6)


def test_gross_outliers_are_down_weighted():
    truth, votes = truth_and_votes(spread=1e-3)
    votes[:, :12] += 0.15  # three tenths of the votes mean something else
    mean, _ = averaged(votes)
    assert np.linalg.norm(votes.mean(1) - truth, axis=-1).min() > 0.05
    assert np.linalg.norm(mean - truth, axis=-1).max() < 0.02


def test_invalid_points_do_not_vote():
    _, votes = truth_and_votes(spread=1e-4)
    valid = torch.ones(2, POINTS, dtype=torch.bool)
    valid[0, 10:] = False
    votes[0, 10:] = 7.0
    mean, _ = averaged(votes, valid=valid)
    np.testing.assert_allclose(mean[0], votes[0, :10].mean(0), atol=1e-6)
    valid[0] = False
    assert all(np.isfinite(part).all() for part in averaged(votes, valid=valid))


@pytest.fixture(scope="module")
def net() -> PointVotingNet:
    torch.manual_seed(0)
    net = PointVotingNet(3, 5, PointConfig(points=POINTS, width=32, pooled=48)).eval()
    with torch.no_grad():
        net.head_weight.normal_()
    return net


def inputs(seed: int = 0) -> tuple[PointMaps, PointCloud, torch.Tensor]:
    """Two made-up clouds a meter away, the second crop with a rotated camera."""
    generator = torch.Generator().manual_seed(seed)

    def randn(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=generator)

    K = torch.tensor([[150.0, 0, 16], [0, 150, 14], [0, 0, 1]]).expand(2, 3, 3).clone()
    K[1, :2, :2] = torch.tensor([[120.0, -90], [90, 120]])
    maps = PointMaps(
        randn(2, 5, 32, 32), 16 + 4 * randn(2, 9, 2), torch.eye(2).expand(2, 9, 2, 2) * 2, K
    )
    xyz = 0.03 * randn(2, POINTS, 3) + torch.tensor([0, 0, 1.0])
    cloud = PointCloud(
        xyz=xyz,
        pixels=16 + 4 * randn(2, POINTS, 2),
        valid=torch.ones(2, POINTS, dtype=torch.bool),
        center=xyz.median(1).values,
        R_crop_cam=crop_frame(K, 32),
    )
    return maps, cloud, torch.tensor([2, 0])


def test_permutation_invariance(net):
    maps, cloud, objects = inputs()
    order = torch.randperm(POINTS, generator=torch.Generator().manual_seed(1))
    other = cloud._replace(xyz=cloud.xyz[:, order], pixels=cloud.pixels[:, order])
    first, second = (net(maps, c, objects, DIAMETER) for c in (cloud, other))
    assert torch.allclose(first.keypoints, second.keypoints, atol=1e-5)
    assert torch.allclose(first.covariance, second.covariance, atol=1e-5)
    assert first.keypoints.shape == (2, 9, 3) and first.covariance.shape == (2, 9, 3, 3)


def test_padding_has_no_effect(net):
    maps, cloud, objects = inputs()
    valid = cloud.valid.clone()
    valid[:, 25:] = False
    moved = torch.where(valid[..., None], cloud.xyz, cloud.xyz + 0.3)
    first, second = (
        net(maps, cloud._replace(valid=valid, xyz=xyz), objects, DIAMETER)
        for xyz in (cloud.xyz, moved)
    )
    assert torch.allclose(first.keypoints, second.keypoints, atol=1e-6)


def test_outputs_depend_on_the_object(net):
    maps, cloud, _ = inputs()
    first, second = (net(maps, cloud, torch.tensor(o), DIAMETER) for o in ([0, 0], [1, 0]))
    assert not torch.allclose(first.keypoints[0], second.keypoints[0], atol=1e-3)
    assert torch.allclose(first.keypoints[1], second.keypoints[1])


def test_translation_equivariance_in_the_crop_frame(net):
    # A cloud that moves as a whole, with its pixels and votes, moves its keypoints by as much. With
    # no votes to look at, the network sees only the shape and the features.
    maps, cloud, objects = inputs()
    first = net(maps, cloud, objects, DIAMETER)
    rays = torch.nn.functional.pad(maps.vote_mean, (0, 1), value=1.0)
    in_crop = rays @ (cloud.R_crop_cam @ torch.linalg.inv(maps.K_grid)).mT
    z = cloud.center[:, None, 2:]
    step = torch.tensor([0.02, -0.03, 0.0])
    points = in_crop / in_crop[..., 2:] * z + step
    votes = project((points @ cloud.R_crop_cam)[0].numpy(), maps.K_grid[0].numpy())
    flat = cloud._replace(xyz=cloud.xyz * torch.tensor([1, 1, 0]) + z * torch.tensor([0, 0, 1]))
    moved = flat._replace(xyz=flat.xyz + step, center=flat.center + step)
    first = net(maps, flat, objects, DIAMETER)
    mean = maps.vote_mean.clone()
    mean[0] = torch.from_numpy(votes)
    second = net(maps._replace(vote_mean=mean), moved, objects, DIAMETER)
    shift = (second.keypoints - first.keypoints)[0]
    assert torch.allclose(shift, (step @ cloud.R_crop_cam[0]).expand(9, 3), atol=1e-4)


def test_gradients_reach_the_features_and_every_parameter(net):
    maps, cloud, objects = inputs()
    features = maps.features.requires_grad_()
    votes = net(maps._replace(features=features), cloud, objects, DIAMETER)
    (votes.keypoints.square().sum() + votes.log_error.sum()).backward()
    assert features.grad.abs().sum() > 0
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None and torch.isfinite(parameter.grad).all(), name
    net.zero_grad()
