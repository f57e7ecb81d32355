"""Trainings, solvers and voting make every tensor on the device of their inputs.

Without a GPU that is seen on a processor that is as strict, see ``strict_host.py``; the tests that
are marked ``cuda`` run the trainings on one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.box_pairs import Pairs
from helpers.strict_host import strict_host
from two_view_pose.pose_estimator.methods import SOLVERS
from two_view_pose.pose_estimator.networks.container import NetworkConfig, PoseNetworks
from two_view_pose.pose_estimator.networks.plane_sweep import group_correlation, sweep
from two_view_pose.pose_estimator.networks.point_cloud import sample_points
from two_view_pose.pose_estimator.networks.volume import PRESETS, LevelConfig
from two_view_pose.pose_estimator.networks.voting import vote_keypoints
from two_view_pose.pose_estimator.solvers.rigid import solve
from two_view_pose.pose_estimator.training.cascade_stage import CascadeStage
from two_view_pose.pose_estimator.training.optimizer import HybridOptimizer
from two_view_pose.pose_estimator.training.point_stage import PointStage
from two_view_pose.pose_estimator.training.stages import (
    DecoderStage,
    DetectorStage,
    FeatureStage,
    StageBase,
)
from two_view_pose.pose_estimator.training.volume_stage import VolumeStage
from two_view_pose.pose_estimator.training_data.crops import CropPack
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet
from two_view_pose.pose_estimator.training_data.target_sample import TargetSample

STAGES = {
    "detector": DetectorStage,
    "features": FeatureStage,
    "decoders": DecoderStage,
    "volume": VolumeStage,
    "paper volume": VolumeStage,
    "cascade": CascadeStage,
    "points": PointStage,
}


class DeepPairs(Pairs):
    """Stands in for a TrainingSet of images with depth."""

    def draw_target(self, rng: np.random.Generator) -> TargetSample:
        return self.draw_pair(rng)[0]


@pytest.fixture
def prepare_stage(pack: CropPack, boxes, monkeypatch):
    # The paper's but for the number of voxels.
    small = replace(
        PRESETS["paper"],
        coarse=replace(PRESETS["paper"].coarse, cells=6),
        fine=LevelConfig(cells=None, half_size=0.65, cell_size=0.05),
    )
    monkeypatch.setitem(PRESETS, "paper", small)

    def prepare(name: str, device: str) -> Callable[[], StageBase]:
        torch.manual_seed(0)
        preset = "paper" if name == "paper volume" else "fast"
        networks = PoseNetworks(boxes, NetworkConfig(preset=preset))
        with torch.no_grad():
            networks.features.head_bias[:, 0] = 9  # all is the object: points are found
        source = TrainingSet(pack, boxes, networks.config.features)
        if name in ("cascade", "points"):
            source = DeepPairs(boxes)
        extra = {"pose_noise": (2.0, 0.01)} if "volume" in name else {}
        networks.to(device)

        def make() -> StageBase:
            stage = STAGES[name](
                networks, source, source, steps=1, batch=2, learning_rate=1e-3, seed=0, **extra
            )
            stage.validation = (1, 2)
            return stage

        return make

    return prepare


@pytest.mark.slow
@pytest.mark.parametrize("name", STAGES)
def test_stages_create_tensors_on_the_device_of_the_networks(prepare_stage, name: str):
    make = prepare_stage(name, "cpu")
    with strict_host():
        stage = make()
        stage.bfloat16 = False
        with torch.device("cpu"):
            batch = next(stage.batches(0))
        loss, parts = stage.loss(batch)
        loss.backward()
        assert all(part.device.type == "cpu" for part in (loss, *parts.values()))
        assert any(p.grad is not None for p in stage.module.parameters())
        assert all(np.isfinite(value) for value in stage.validate().values())


@pytest.mark.parametrize("solver", SOLVERS)
def test_solvers_create_tensors_on_the_device_of_the_keypoints(boxes, solver):
    # One model for each pose: what a processor remembers of a model, no GPU sees.
    model = torch.from_numpy(boxes["brick"].keypoints).float().expand(2, 9, 3)
    predicted = (model + 0.1 + 0.01 * torch.rand(2, 9, 3)).requires_grad_()
    diameters = torch.tensor([0.15, 0.2])
    with strict_host():
        for diameter in (0.15, diameters):
            motion = solve(model, predicted, diameter, solver)
            (motion.rotation.sum() + motion.translation.sum()).backward()
    assert motion.rotation.device.type == "cpu" and torch.isfinite(predicted.grad).all()


def test_votes_points_and_plane_sweeps_stay_on_the_device_of_their_inputs():
    # All pixels take part in the first, a draw of them in the second.
    fields = [(torch.randn(2, 9, 2, n, n), torch.rand(2, 9, n, n)) for n in (12, 24)]
    K = torch.tensor([[100.0, 0, 15.5], [0, 100, 15.5], [0, 0, 1]]).expand(2, 3, 3)
    depth, mask = 1 + 0.01 * torch.rand(2, 32, 32), torch.ones(2, 8, 8)
    generators = [torch.Generator().manual_seed(n) for n in range(2)]
    diameter, T = torch.full((2,), 0.2), torch.eye(4).expand(2, 4, 4)
    planes, features = torch.rand(2, 5, 32, 32) + 0.5, torch.rand(2, 8, 32, 32)
    with strict_host():
        for directions, weights in fields:
            votes = vote_keypoints(directions, weights)
        clouds = [
            sample_points(depth, mask, K, diameter, 32, g) for g in (generators[0], generators)
        ]
        warped, inside = sweep(features, K, K, T, planes)
        alike = group_correlation(features, warped, 4)
    found = (votes.mean, votes.covariance, *(c.xyz for c in clouds), warped, inside, alike)
    assert all(part.device.type == "cpu" for part in found)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda x: x + torch.zeros(3),
        lambda x: x[None] @ torch.eye(3),
        lambda x: x + torch.from_numpy(np.ones(3)),
        lambda x: x.numpy(),
        lambda x: np.asarray(x),
        lambda x: torch.rand(3) + x,
    ],
)
def test_strict_host_rejects_what_a_gpu_rejects(wrong):
    x = torch.ones(3)
    with strict_host(), pytest.raises((RuntimeError, NotImplementedError)):
        wrong(x)
    with strict_host():
        moved = torch.from_numpy(np.ones(3)).float().to(x.device)
        assert (moved + x).cpu().numpy().tolist() == [2, 2, 2]


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA GPU")
@pytest.mark.parametrize("name", STAGES)
def test_a_step_on_a_gpu(prepare_stage, name: str):
    stage = prepare_stage(name, "cuda")()
    stage.bfloat16 = torch.cuda.is_bf16_supported()
    optimizer = HybridOptimizer(stage.module, 1e-3, 1e-4)
    before = {n: p.detach().clone() for n, p in stage.module.named_parameters()}
    (batch,) = stage.batches(0)
    assert all(tensor.is_cuda for tensor in batch.values())
    loss, _ = stage.loss(batch)
    loss.backward()
    optimizer.step(1e-3)
    assert loss.is_cuda and torch.isfinite(loss)
    after = dict(stage.module.named_parameters())
    assert any(not torch.equal(before[name], after[name]) for name in before)
    assert all(torch.isfinite(p).all() for p in after.values())
    assert all(np.isfinite(value) for value in stage.validate().values())
