"""The training of the points: its losses by hand, and that it learns from depth alone."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from helpers.boxes_with_depth import box_depth
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
from two_view_pose.pose_estimator.training_data.target_sample import TargetSample, arrays_of

SIDE = 128


class MaskFromColor(nn.Module):
    """Stands in for the 2D network: bright pixels are the object, and nothing else is known."""

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
    """Stands in for a TrainingSet: boxes before a wall, one of a few poses each."""

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
    """A batch of samples with the depth that they have."""
    seeds = enumerate(samples)
    return collate([{**arrays_of(s), "depth": s.depth, "points_seed": n} for n, s in seeds])


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


def test_a_dataset_without_depth_is_refused(pack: CropPack, boxes, networks: PoseNetworks):
    training = TrainingSet(pack, boxes, networks.features.config)
    stage = PointStage(networks, training, training, steps=1, batch=1, learning_rate=1.0, seed=0)
    networks.requires_grad_(True)
    with pytest.raises(ValueError, match=r"needs depth maps.*generate --depth"):
        stage.batches(0)


def test_points_learn_a_few_poses_from_their_shape_alone(make_stage):
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
    # One that shows nothing is left out, and a batch of such still has a (zero) gradient.
    blank = exact(stage.train.samples[:1])
    blank["crop"].zero_()
    loss, _ = stage.loss(blank)
    loss.backward()
    assert float(loss.detach()) == 0


def test_batches_are_noisy_and_go_on_from_any_number(make_stage):
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


def test_symmetric_objects_may_answer_with_any_equivalent_pose(make_stage, boxes):
    stage = make_stage(2)
    T = torch.from_numpy(stage.train.samples[1].T_cam_obj).float().expand(2, 4, 4)
    crate = boxes["crate"]
    turned = (T[0].double().numpy() @ crate.symmetries[1])[:3]
    keypoints = torch.from_numpy(crate.keypoints @ turned[:, :3].T + turned[:, 3]).float()
    answers = torch.stack([keypoints, keypoints])
    chosen = stage.nearest_equivalent(answers, T, torch.tensor([1, 0]))
    np.testing.assert_allclose(chosen[0][:3], turned, atol=1e-6)  # the crate is symmetric
    assert torch.equal(chosen[1], T[1])  # the brick is not


def test_losses_of_votes_by_hand():
    truth = torch.zeros(1, 9, 3)
    candidates = torch.zeros(1, 3, 9, 3)
    candidates[0, 0, :, 0] = 0.02  # a tenth of the diameter
    candidates[0, 1, :, 1] = 0.06
    candidates[0, 2] = 9.0
    log_error = torch.full((1, 3, 9), float(np.log(0.1)), requires_grad=True)
    candidates.requires_grad_()
    votes = PointVotes(candidates, log_error, truth, truth)
    offset, sure = vote_losses(
        votes, truth, torch.tensor([[True, True, False]]), torch.tensor([0.2])
    )
    assert float(offset.detach()) == pytest.approx((0.1 + 0.3) / 2)
    assert float(sure.detach()) == pytest.approx((1 + 3) / 2 + np.log(0.1))
    sure.backward()
    assert candidates.grad is None
    # The best width is the error itself: there the slope is zero, and beyond it is negative.
    np.testing.assert_allclose(log_error.grad[0, :2, 0], [0, -2 / 18], atol=1e-6)


def test_validation_is_of_the_held_out_crops(make_stage):
    stage = make_stage(2)
    stage.validation = (1, 32)
    figures = stage.validate()
    assert set(figures) == {"keypoint_over_diameter", "add_recall"}
    assert 0 <= figures["add_recall"] <= 1 and figures["keypoint_over_diameter"] > 0
    assert figures == stage.validate()
