"""The size head: its truth is the apparent size, its losses are by hand, and it gives depths."""

import numpy as np
import pytest
import torch
from two_view_pose.pose_estimator.dataset import TrainingSet, stack_targets
from two_view_pose.pose_estimator.features import FeatureConfig
from two_view_pose.pose_estimator.frontend import depth_priors
from two_view_pose.pose_estimator.geometry import LINEMOD_K, crop_matrix
from two_view_pose.pose_estimator.networks import PoseNetworks
from two_view_pose.pose_estimator.size_head import SizeHead, size_losses
from two_view_pose.pose_estimator.stages import FeatureStage


@pytest.fixture
def stage(pack, boxes) -> FeatureStage:
    torch.manual_seed(0)
    networks = PoseNetworks(boxes)
    training = TrainingSet(pack, boxes, networks.features.config)
    return FeatureStage(networks, training, training, steps=1, batch=1, learning_rate=1.0, seed=0)


def test_the_true_size_gives_the_true_depth(stage):
    """Whatever turn, shift and scale the crop has been given."""
    rng = np.random.default_rng(0)
    samples = [stage.train.draw_target(rng) for _ in range(8)]
    tensors = stack_targets(samples)
    true = stage.true_sizes(tensors)
    assert true.abs().max() < 0.4 and true.std() > 0.01  # the crops' scale is jittered
    diameters = [stage.train.models[s.object_index].diameter for s in samples]
    size = torch.stack([true, torch.full_like(true, -3.0)], 1)
    priors = depth_priors(size, tensors["K"], diameters, stage.networks.features.config)
    for prior, sample in zip(priors, samples, strict=True):
        assert prior.depth == pytest.approx(sample.T_cam_obj[2, 3], rel=1e-4)
        assert prior.deviation == pytest.approx(np.sqrt(2) * np.exp(-3.0))


def test_a_larger_object_is_nearer():
    config = FeatureConfig()
    K = torch.from_numpy(crop_matrix(np.array([300.0, 200.0]), 120.0, 128) @ LINEMOD_K)[None]
    near, far = (
        depth_priors(torch.tensor([[size, -9.0]]), K, [0.15], config)[0] for size in (0.1, 0.0)
    )
    assert near.depth == pytest.approx(far.depth * np.exp(-0.1))
    assert far.depth == pytest.approx(572.99 * 0.15 * 1.4 / 120, rel=1e-3)
    assert near.deviation == 0.01  # none is believed more than that


def test_losses_by_hand():
    size = torch.tensor([[0.1, -2.0], [-0.2, -1.0]], requires_grad=True)
    miss, likelihood = size_losses(size, torch.tensor([0.0, 0.1]))
    assert miss.item() == pytest.approx(0.2)
    by_hand = np.mean([0.1 * np.exp(2.0) - 2.0, 0.3 * np.exp(1.0) - 1.0])
    assert likelihood.item() == pytest.approx(by_hand, rel=1e-5)
    likelihood.backward()
    assert not size.grad[:, 0].any() and size.grad[:, 1].all()
    # It is least where the width is the error.
    right = torch.tensor([[0.1, np.log(0.1)], [-0.2, np.log(0.3)]], dtype=torch.float32)
    assert size_losses(right, torch.tensor([0.0, 0.1]))[1] < likelihood


def test_the_head_learns_the_size_of_a_disc():
    torch.manual_seed(0)
    head = SizeHead(2, (3, 5), 4, 4).train()
    optimizer = torch.optim.Adam(head.parameters(), 2e-3)
    rows, columns = torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="ij")
    errors = []
    for _ in range(150):
        radius = torch.empty(16).uniform_(5, 14)
        middle = torch.empty(16, 2, 1, 1).uniform_(13, 18)
        distance = ((columns - middle[:, 0]) ** 2 + (rows - middle[:, 1]) ** 2).sqrt()
        mask = 4 * (radius[:, None, None] - distance)
        size = head(
            torch.zeros(16, 2, 32, 32), mask, torch.zeros(16, 3, 8, 8), torch.zeros(16, 5, 4, 4),
            torch.zeros(16, 4),
        )  # fmt: skip
        miss, likelihood = size_losses(size, torch.log(radius / 9))
        optimizer.zero_grad()
        (miss + 0.1 * likelihood).backward()
        optimizer.step()
        errors.append(miss.item())
    assert np.mean(errors[-20:]) < 0.25 * np.mean(errors[:5])


def test_the_features_stage_trains_the_head(stage):
    rng = np.random.default_rng(0)
    loss, parts = stage.loss([stage.train.draw_target(rng) for _ in range(2)])
    loss.backward()
    head = stage.networks.features.size_head
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in head.parameters())
    assert set(parts) == {"mask", "direction", "size"}
    assert "size_error" in stage.validate()
