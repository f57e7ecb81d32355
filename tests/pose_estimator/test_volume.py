"""The volume: exact votes are triangulated, the joint pose helps, gradients reach the features."""

import numpy as np
import pytest
import torch
from two_exact_views import CENTRE, DIAMETER, flat_prior, nine_keypoints, view_maps
from two_view_pose.pose_estimator.geometry import make_transform
from two_view_pose.pose_estimator.lifting import KeypointPrior, ViewMaps
from two_view_pose.pose_estimator.losses import pose_loss
from two_view_pose.pose_estimator.soft_ransac import SoftRansacConfig, soft_ransac
from two_view_pose.pose_estimator.volume import PRESETS, VolumeNet


def net_that_trusts_votes() -> VolumeNet:
    net = VolumeNet(4)
    for volume in (net.coarse, net.fine):
        torch.nn.init.zeros_(volume.output.weight)
        torch.nn.init.ones_(volume.trust)
    return net.eval()


@pytest.mark.parametrize("deviation", [0.05, 0.3, 0.6])
@pytest.mark.parametrize("bfloat16", [False, True])
def test_exact_votes_are_triangulated_to_a_fraction_of_a_voxel(deviation, bfloat16):
    keypoints = nine_keypoints()
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
        coarse, fine = net_that_trusts_votes()(
            view_maps(keypoints, deviation), flat_prior(keypoints), torch.tensor([DIAMETER])
        )
    for level, limit in ((coarse, 0.5), (fine, 0.35)):
        assert level.keypoints.dtype == torch.float32
        error = np.linalg.norm(level.keypoints[0].numpy() - keypoints, axis=1)
        assert error.mean() < limit * float(level.cell_size)


def test_two_views_know_more_of_a_point_than_its_ray():
    keypoints = nine_keypoints()
    maps = view_maps(keypoints)
    single = ViewMaps(*(part[:, :1] for part in maps))
    with torch.no_grad():
        pair, alone = (
            net_that_trusts_votes()(m, flat_prior(keypoints), torch.tensor([DIAMETER]))[-1]
            for m in (maps, single)
        )
    assert (pair.covariance[0, :, 2, 2] < 0.5 * alone.covariance[0, :, 2, 2]).all()
    assert torch.isfinite(alone.keypoints).all()


def test_the_joint_pose_gives_the_depth_that_votes_of_one_view_cannot():
    keypoints = nine_keypoints()
    single = ViewMaps(*(part[:, :1] for part in view_maps(keypoints)))
    sharp = KeypointPrior(
        torch.from_numpy(keypoints).float()[None], torch.eye(3).expand(1, 9, 3, 3) * 1e-6
    )
    errors = []
    with torch.no_grad():
        for prior in (flat_prior(keypoints), sharp):
            fine = net_that_trusts_votes()(single, prior, torch.tensor([DIAMETER]))[-1]
            errors.append(np.linalg.norm(fine.keypoints[0].numpy() - keypoints, axis=1).mean())
    assert errors[1] < 0.3 * errors[0] and errors[1] < 0.005


def test_three_views_are_welcome():
    maps = view_maps(nine_keypoints())
    third = ViewMaps(*(torch.cat([part, part[:, 1:]], 1) for part in maps))
    prior = flat_prior(nine_keypoints())
    with torch.no_grad():
        fine = net_that_trusts_votes()(third, prior, torch.tensor([DIAMETER]))[-1]
    error = np.linalg.norm(fine.keypoints[0].numpy() - nine_keypoints(), axis=1)
    assert error.mean() < 0.01


def test_the_pose_loss_reaches_the_lifted_features():
    torch.manual_seed(0)
    keypoints = nine_keypoints()
    features = torch.randn(1, 2, 4, 32, 32, requires_grad=True)
    net = VolumeNet(4).train()
    levels = net(
        view_maps(keypoints, features=features),
        flat_prior(keypoints),
        torch.tensor([DIAMETER]),
    )
    model = torch.from_numpy(keypoints - CENTRE).float()
    solution = soft_ransac(model, levels[-1].keypoints, SoftRansacConfig.for_diameter(DIAMETER))
    truth = torch.from_numpy(make_transform(np.eye(3), CENTRE + 0.01)).float()[None]
    loss = pose_loss(
        solution.rotation, solution.translation, truth, torch.tensor([DIAMETER]), alpha=0.3
    )
    loss.backward()
    assert features.grad is not None
    assert torch.isfinite(features.grad).all() and features.grad.abs().sum() > 0
    assert net.fine.outside.grad is not None


def test_the_paper_preset_has_the_papers_grids():
    diameter = torch.tensor([0.2])
    paper = PRESETS["paper"]
    count, half = paper.coarse.shape(diameter)
    assert count == 60 and float(half) == pytest.approx(0.3)
    assert 2 * float(half) / count == pytest.approx(0.01)
    count, half = paper.fine.shape(diameter)
    assert 2 * float(half) / count == pytest.approx(0.005, rel=0.02)
    assert 2 * float(half) > 0.2
    assert not paper.evidence and paper.coarse_pose
    # Voxels keep their size also where a batch mixes objects: its volumes fit the largest.
    count, half = paper.fine.shape(torch.tensor([0.1, 0.2831, 0.15]))
    assert torch.allclose(2 * half / count, torch.full((3,), 0.005))
    assert 1.3 * 0.2831 <= 2 * float(half[0]) < 1.3 * 0.2831 + 0.0051


def test_the_fast_preset_scales_with_the_object():
    fast = PRESETS["fast"]
    for level in (fast.coarse, fast.fine):
        small, large = level.shape(torch.tensor([0.1])), level.shape(torch.tensor([0.2]))
        assert small[0] == large[0] <= 16
        assert float(large[1]) == pytest.approx(2 * float(small[1]))
