"""Losses against closed forms."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.distributions import Categorical, kl_divergence
from two_view_pose.pose_estimator.networks.volume import voxel_centers
from two_view_pose.pose_estimator.training.losses import (
    direction_loss,
    distribution_loss,
    keypoint_loss,
    pose_loss,
)


def test_distribution_loss_is_the_kl_divergence_to_the_gaussian():
    torch.manual_seed(0)
    cells = voxel_centers(torch.tensor([[0.0, 0.0, 1.0]]), torch.tensor([0.1]), 5)
    keypoints = torch.rand(1, 9, 3) * 0.1 + torch.tensor([-0.05, -0.05, 0.95])
    logits = torch.randn(1, 9, 125)
    squared = (keypoints[:, :, None] - cells[:, None]).square().sum(-1)
    target = Categorical(logits=-squared / (2 * 0.03**2))
    expected = kl_divergence(target, Categorical(logits=logits)).mean()
    value = distribution_loss(torch.log_softmax(logits, -1), cells, keypoints, torch.tensor([0.03]))
    assert float(value) == pytest.approx(float(expected), rel=1e-3)
    own = torch.log_softmax(-squared / (2 * 0.03**2), -1)
    assert float(distribution_loss(own, cells, keypoints, torch.tensor([0.03]))) < 1e-4
    reverse = kl_divergence(Categorical(logits=logits), target).mean()
    value = distribution_loss(
        torch.log_softmax(logits, -1), cells, keypoints, torch.tensor([0.03]), predicted_first=True
    )
    assert float(value) == pytest.approx(float(reverse), rel=1e-3) != pytest.approx(float(expected))


def test_pose_loss_of_a_known_rotation_and_translation():
    angle = 0.4
    truth = torch.eye(4)[None]
    rotated = torch.from_numpy(Rotation.from_rotvec([0, angle, 0]).as_matrix()).float()[None]
    loss = pose_loss(
        rotated, torch.tensor([[0.03, 0.0, 0.04]]), truth, torch.tensor([0.1]), alpha=0.3
    )
    # |R - I|_F = 2 sqrt(2) sin(angle / 2)
    expected = 0.5 + 0.3 * 2 * np.sqrt(2) * np.sin(angle / 2)
    assert float(loss) == pytest.approx(expected, rel=1e-5)


def test_the_gradient_of_a_perfect_pose_is_finite():
    rotation = torch.eye(3)[None].requires_grad_()
    translation = torch.zeros(1, 3, requires_grad=True)
    pose_loss(rotation, translation, torch.eye(4)[None], torch.ones(1), 0.3).backward()
    assert rotation.grad is not None and translation.grad is not None
    assert torch.isfinite(rotation.grad).all() and torch.isfinite(translation.grad).all()


def test_keypoint_loss_is_the_distance_in_diameters():
    truth = torch.zeros(2, 9, 3)
    predicted = truth + torch.tensor([0.0, 0.03, 0.04])
    assert float(keypoint_loss(predicted, truth, torch.tensor([0.1, 0.2]))) == pytest.approx(0.375)


def test_direction_loss_ignores_the_background():
    target = torch.zeros(1, 9, 2, 8, 8)
    target[:, :, 0] = 1
    mask = torch.zeros(1, 8, 8)
    mask[:, 2:6, 2:6] = 1
    wrong_outside = torch.where(mask[:, None, None] > 0, target, torch.full_like(target, 7.0))
    assert float(direction_loss(wrong_outside, target, mask)) == 0
    assert float(direction_loss(-target, target, mask)) == pytest.approx(2 - 0.1)
    assert float(direction_loss(-target, target, torch.zeros(1, 8, 8))) == 0
