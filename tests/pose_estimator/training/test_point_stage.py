"""Training of the points: losses by hand, learning from depth alone."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from helpers.boxes import box_depth
from scipy.spatial.transform import Rotation
from torch import nn
from torch.nn import functional as F
from two_view_pose.core.geometry import LINEMOD_K, crop_matrix, make_transform, project
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.features import FeatureConfig, Features2D
from two_view_pose.pose_estimator.networks.point_voting import (
    PointConfig,
    PointVotes,
    PointVotingNet,
)
from two_view_pose.pose_estimator.training.loader import Batch, collate
from two_view_pose.pose_estimator.training.point_stage import (
    PointStage,
    draw_with_sensor_noise,
    vote_losses,
)
from two_view_pose.pose_estimator.training_data.crops import CropPack
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet
from two_view_pose.pose_estimator.training_data.target_sample import TargetSample, target_arrays

SIDE = 128


class MaskFromColor(nn.Module):
    """Stub of the 2D network: bright pixels are the object."""

    config = FeatureConfig()

    def forward(self, crops: torch.Tensor, objects: torch.Tensor) -> Features2D:
        covered = F.avg_pool2d(crops[:, :1] / 255, 4)[:, 0]
        return Features2D(
            mask_logits=20 * covered - 10,
            directions=crops.new_zeros(len(crops), 9, 2, 32, 32),
            volume=crops.new_zeros(len(crops), 32, 32, 32),
            decoder=crops.new_zeros(len(crops), 64, 32, 32),
        )


class Crops:
    """Stub of a TrainingSet: boxes in front of a wall, in a few poses each."""

    def __init__(self, boxes, count: int):
        self.models = list(boxes.values())
        self.targets = np.arange(count)
        self.pack = SimpleNamespace(depth=lambda target: np.ones(1))
        rng = np.random.default_rng(0)
        self.samples = [self.make(k % len(boxes), rng) for k in range(count)]

    def make(self, index: int, rng: np.random.Generator) -> TargetSample:
        model = self.models[index]
        place = np.append(rng.uniform(-0.1, 0.1, 2), rng.uniform(0.7, 1.1))
        T = make_transform(Rotation.random(random_state=int(rng.integers(1000))).as_matrix(), place)
        center = project(place, LINEMOD_K) + rng.normal(0, 3, 2)
        side = 1.4 * model.diameter * 572 / place[2]
        K = crop_matrix(center, side, SIDE) @ LINEMOD_K
        depth = box_depth(model, T, K, (SIDE, SIDE))
        crop = np.where(depth[..., None] > 0, 255, 0).astype(np.uint8).repeat(3, 2)
        return TargetSample(
            crop=crop,
            mask=np.zeros((32, 32), np.float32),
            directions=np.zeros((9, 2, 32, 32), np.float32),
            object_index=index,
            K=K,
            T_cam_obj=T,
            depth=np.where(depth > 0, depth, place[2] + 0.3).astype(np.float32),
        )

    def draw_target(self, rng: np.random.Generator) -> TargetSample:
        return self.samples[int(rng.integers(len(self.samples)))]


def exact(samples: list[TargetSample]) -> Batch:
    """A batch of samples without depth noise."""
    seeds = enumerate(samples)
    return collate([{**target_arrays(s), "depth": s.depth, "points_seed": n} for n, s in seeds])


@pytest.fixture
def make_stage(boxes):
    def make(count: int) -> PointStage:
        torch.manual_seed(0)
        networks = SimpleNamespace(
            device=torch.device("cpu"),
            features=MaskFromColor(),
            points=PointVotingNet(2, 65, PointConfig(points=64, width=64, pooled=64)),
        )
        crops = Crops(boxes, count)
        return PointStage(networks, crops, crops, steps=2, batch=count, learning_rate=1.0, seed=0)

    return make


def test_a_dataset_without_depth_is_rejected(pack: CropPack, boxes, networks: PoseNetworks):
    training = TrainingSet(pack, boxes, networks.features.config)
    stage = PointStage(networks, training, training, steps=1, batch=1, learning_rate=1.0, seed=0)
    networks.requires_grad_(True)
    with pytest.raises(ValueError, match=r"needs depth maps.*generate --depth"):
        stage.batches(0)


@pytest.mark.slow
def test_points_overfit_to_a_few_poses(make_stage):
    stage = make_stage(2)
    batch = exact(stage.train.samples)
    optimizer = torch.optim.Adam(stage.module.parameters(), 3e-3)

    def distance() -> float:
        return float(stage.loss(batch)[1]["distance"].detach())

    before = distance()
    for _ in range(40):
        optimizer.zero_grad()
        stage.loss(batch)[0].backward()
        optimizer.step()
    assert before > 0.2
    assert distance() < 0.06


def test_the_same_batch_gives_the_same_loss(make_stage):
    stage = make_stage(3)
    first, again = (float(stage.loss(exact(stage.train.samples))[0].detach()) for _ in range(2))
    assert first == again
    # A batch without enough points has a zero loss and gradient.
    blank = exact(stage.train.samples[:1])
    blank["crop"].zero_()
    loss, _ = stage.loss(blank)
    loss.backward()
    assert float(loss.detach()) == 0


def test_batches_have_sensor_noise_and_resume_from_any_number(make_stage):
    stage = make_stage(3)
    source = stage.batches(0)
    first, second = next(source), next(source)
    source.close()
    resumed = stage.batches(1)
    again = next(resumed)
    resumed.close()
    assert all(torch.equal(second[name], again[name]) for name in second)
    depths = [torch.from_numpy(s.depth) for s in stage.train.samples]
    assert not any(torch.equal(noisy, depth) for noisy in first["depth"] for depth in depths)
    assert draw_with_sensor_noise(stage.train, np.random.default_rng(0))["depth"].shape == (
        SIDE,
        SIDE,
    )


def test_nearest_equivalent_pose_of_symmetric_objects(make_stage, boxes):
    stage = make_stage(2)
    T = torch.from_numpy(stage.train.samples[1].T_cam_obj).float().expand(2, 4, 4)
    crate = boxes["crate"]
    rotated = (T[0].double().numpy() @ crate.symmetries[1])[:3]
    keypoints = torch.from_numpy(crate.keypoints @ rotated[:, :3].T + rotated[:, 3]).float()
    predicted = torch.stack([keypoints, keypoints])
    chosen = stage.nearest_equivalent(predicted, T, torch.tensor([1, 0]))
    np.testing.assert_allclose(chosen[0][:3], rotated, atol=1e-6)  # the crate is symmetric
    assert torch.equal(chosen[1], T[1])  # the brick is not


def test_vote_losses_by_hand():
    truth = torch.zeros(1, 9, 3)
    candidates = torch.zeros(1, 3, 9, 3)
    candidates[0, 0, :, 0] = 0.02  # a tenth of the diameter
    candidates[0, 1, :, 1] = 0.06
    candidates[0, 2] = 9.0
    log_error = torch.full((1, 3, 9), float(np.log(0.1)), requires_grad=True)
    candidates.requires_grad_()
    votes = PointVotes(candidates, log_error, truth, truth)
    offset, confidence = vote_losses(
        votes, truth, torch.tensor([[True, True, False]]), torch.tensor([0.2])
    )
    assert float(offset.detach()) == pytest.approx((0.1 + 0.3) / 2)
    assert float(confidence.detach()) == pytest.approx((1 + 3) / 2 + np.log(0.1))
    confidence.backward()
    assert candidates.grad is None
    # The best width is the error itself: there the slope is zero, and beyond it is negative.
    np.testing.assert_allclose(log_error.grad[0, :2, 0], [0, -2 / 18], atol=1e-6)


def test_validation_is_deterministic(make_stage):
    stage = make_stage(2)
    stage.validation = (1, 32)
    metrics = stage.validate()
    assert set(metrics) == {"keypoint_over_diameter", "add_recall"}
    assert 0 <= metrics["add_recall"] <= 1 and metrics["keypoint_over_diameter"] > 0
    assert metrics == stage.validate()
