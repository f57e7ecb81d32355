"""Training of the cascade: targets and loss by hand, and a step lowers the loss."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from helpers.box_pairs import Pairs
from torch import nn
from two_view_pose.core.geometry import grid_matrix
from two_view_pose.pose_estimator.networks.cascade import DepthOutput
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.training.cascade_stage import (
    CascadeStage,
    DepthTarget,
    depth_loss,
    depth_target,
)
from two_view_pose.pose_estimator.training_data.crops import CropPack
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet


@pytest.fixture
def stage(boxes, networks: PoseNetworks):
    pairs = Pairs(boxes)
    yield CascadeStage(networks, pairs, pairs, steps=1, batch=2, learning_rate=1.0, seed=0)
    networks.requires_grad_(True)
    networks.eval()


@pytest.mark.parametrize("stride", [2, 4, 8])
def test_depth_target_is_the_depth_at_the_cell_centers(stride):
    rows, columns = np.indices((32, 32))
    depth = np.float32(0.9 + 0.001 * columns + 0.0004 * rows)
    mask = torch.rand(1, 8, 8)
    truth = depth_target(torch.from_numpy(depth)[None], mask, stride, torch.tensor([0.002]))
    cells = np.stack(np.meshgrid(np.arange(32 // stride), np.arange(32 // stride)), -1)
    homogeneous = np.concatenate([cells, np.ones((*cells.shape[:2], 1))], -1)
    centers = homogeneous @ np.linalg.inv(grid_matrix(stride)).T
    assert np.allclose(truth.depth[0], 0.9 + 0.001 * centers[..., 0] + 0.0004 * centers[..., 1])
    assert truth.mask.shape == truth.depth.shape
    if stride == 8:
        assert np.allclose(truth.mask[0], mask[0].reshape(4, 2, 4, 2).mean((1, 3)), atol=1e-6)
    else:
        repeat = 4 // stride
        assert np.array_equal(truth.mask[0], np.kron(mask[0], np.ones((repeat, repeat))))


def test_depth_target_excludes_edges_and_unknown_depth():
    depth = torch.full((1, 8, 8), 0.8)
    depth[:, :, 5:] = 1.0  # an edge within the third column of cells
    depth[:, 0, 0] = 0.0
    depth[:, 6:, 1] = 0.811  # no edge, where a pixel is two millimeters wide
    cells = depth_target(depth, torch.ones(1, 2, 2), 2, torch.tensor([0.002])).depth[0]
    finer = depth_target(depth, torch.ones(1, 2, 2), 2, torch.tensor([0.001])).depth[0]
    assert cells[0, 0] == 0 and (cells[:, 2] == 0).all()
    assert torch.allclose(cells[1:3, :2], torch.tensor(0.8))
    assert cells[3, 0] > 0.8 and finer[3, 0] == 0
    assert torch.allclose(cells[:, 3], torch.tensor(1.0))


def test_depth_loss_by_hand():
    # Spacing 0.01: off by 5 mm, by 30 mm, unknown, and out of the range.
    output = DepthOutput(
        depth=torch.tensor([[[0.805, 0.83, 0.9, 0.8]]]),
        variance=torch.zeros(1, 1, 4),
        center=torch.full((1, 1, 4), 0.8),
        half_range=torch.tensor([0.04]),
        stride=2,
    )
    truth = DepthTarget(
        torch.tensor([[[0.8, 0.8, 0.0, 0.85]]]), torch.tensor([[[1.0, 0.0, 1.0, 1.0]]])
    )
    expected = (1.0 * 0.5 * 0.5**2 + 0.1 * (3 - 0.5)) / 8
    assert float(depth_loss(output, truth, planes=9)) == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_only_the_cascade_is_trained_and_a_step_lowers_the_loss(stage: CascadeStage):
    batch = next(stage.batches(0))
    before = {n: t.clone() for n, t in stage.module.state_dict().items()}
    optimizer = torch.optim.SGD(stage.module.parameters(), 0.001)
    losses = []
    try:
        for _ in range(2):
            loss, parts = stage.loss(batch)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(float(loss.detach()))
        assert set(parts) == {"coarse", "middle", "fine"}
        assert losses[1] < losses[0]
        frozen = [*stage.networks.features.parameters(), *stage.networks.detector.parameters()]
        assert all(p.grad is None for p in frozen)
    finally:
        stage.module.load_state_dict(before)
        stage.module.zero_grad()


class BiasedCascade(nn.Module):
    """A cascade whose depths are five millimeters too far."""

    def __init__(self, config, drawn: list[np.ndarray]):
        super().__init__()
        self.config = config
        self.drawn = drawn

    def forward(self, views, guess, diameter):
        assert len(views.maps) == 4 and views.K.shape[1:] == (2, 3, 3)
        depth = torch.from_numpy(np.stack(self.drawn))
        self.drawn.clear()
        outputs = []
        for level in self.config.levels:
            truth = depth_target(
                depth, torch.ones(len(depth), 32, 32), level.stride, torch.ones(len(depth))
            )
            cells = truth.depth + 0.005
            outputs.append(DepthOutput(cells, cells, cells, torch.ones(len(depth)), level.stride))
        return outputs


def test_validation_measures_the_depth_error_in_millimeters(stage: CascadeStage, monkeypatch):
    drawn: list[np.ndarray] = []
    draw = stage.held_out.draw_pair
    fixed = draw(np.random.default_rng(0))

    def noted(rng):
        drawn.append(fixed[0].depth)
        return fixed

    monkeypatch.setattr(stage, "held_out", SimpleNamespace(draw_pair=noted))
    biased = BiasedCascade(stage.networks.cascade.config, drawn)
    monkeypatch.setattr(
        stage.networks.features.encoder, "pyramid",
        lambda crops: [crops.new_zeros(len(crops), 1, 1, 1)] * 5,
    )  # fmt: skip
    stage.networks = SimpleNamespace(features=stage.networks.features, cascade=biased)
    numbers = stage.validate()
    assert numbers["depth_error_mm"] == pytest.approx(5, abs=1e-3)
    assert numbers["depth_error_mm_p80"] == pytest.approx(5, abs=1e-3)


def test_a_dataset_without_depth_is_rejected(pack: CropPack, boxes, networks: PoseNetworks):
    source = TrainingSet(pack, boxes, networks.features.config, validation=0.3)
    stage = CascadeStage(networks, source, source, steps=1, batch=1, learning_rate=1.0, seed=0)
    networks.requires_grad_(True)
    with pytest.raises(ValueError, match=r"cascade needs depth maps.*generate --depth"):
        stage.batches(0)
