"""Training of the volume: gradients of the pose loss, and pose noise."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import make_transform
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.volume import LevelOutput
from two_view_pose.pose_estimator.training.loader import Batch, collate
from two_view_pose.pose_estimator.training.losses import pose_loss
from two_view_pose.pose_estimator.training.volume_stage import VolumeStage
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet


@pytest.fixture
def stage(pack, boxes) -> VolumeStage:
    torch.manual_seed(0)
    networks = PoseNetworks(boxes)
    training = TrainingSet(pack, boxes, networks.features.config, None)
    stage = VolumeStage(networks, training, training, steps=1, batch=2, learning_rate=1.0, seed=0)
    stage.bfloat16 = False
    return stage


@pytest.fixture
def pairs(stage) -> Batch:
    return drawn(stage)


def drawn(stage: VolumeStage) -> Batch:
    """The same two pairs each time, with the stage's pose noise."""
    draw, rng = stage.sample_function(stage.train), np.random.default_rng
    return collate([draw(rng(number)) for number in range(2)])


def pose_part(stage: VolumeStage, pairs: Batch) -> torch.Tensor:
    """The pose loss of the fine level alone."""
    out = stage.forward(pairs)
    solution = stage.solve(out["levels"][-1], out)
    return pose_loss(
        solution.rotation, solution.translation, out["T_true"], out["diameter"], alpha=0.3
    )


@pytest.mark.slow
def test_the_pose_loss_trains_the_features(stage, pairs):
    stage.networks.volume.train()
    lifted: list[torch.Tensor] = []

    def keep(module: torch.nn.Module, arguments: tuple) -> None:
        arguments[0].features.retain_grad()
        lifted.append(arguments[0].features)

    # The placement of the fine volume has no gradient, so it is kept fixed.
    first: list[LevelOutput] = []

    def stay(module: torch.nn.Module, arguments: tuple, output: LevelOutput) -> LevelOutput:
        first.append(LevelOutput(*(part.detach() for part in output)))
        return first[0]

    stage.networks.volume.coarse.register_forward_hook(stay)
    hook = stage.networks.volume.register_forward_pre_hook(keep)
    pose_part(stage, pairs).backward()
    hook.remove()
    (features,) = lifted
    assert features.grad is not None and torch.isfinite(features.grad).all()
    assert (features.grad.abs().flatten(2).sum(-1) > 0).all()  # both views of both pairs
    head = stage.networks.features.volume_heads[0].weight
    assert head.grad is not None
    # Along its own gradient the loss changes as fast as the gradient says.
    direction = head.grad / head.grad.norm()
    step = 0.05 * float(head.detach().norm())
    with torch.no_grad():
        ends = []
        for sign in (1, -1):
            head += sign * step * direction
            ends.append(float(pose_part(stage, pairs)))
            head -= sign * step * direction
    assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(float(head.grad.norm()), rel=0.1)
    frozen = [p for n, p in stage.networks.features.named_parameters() if "volume_head" not in n]
    assert all(p.grad is None for p in frozen)


@pytest.mark.slow
def test_end_to_end_training_reaches_all_features_that_are_not_frozen(pack, boxes):
    torch.manual_seed(0)
    networks = PoseNetworks(boxes)
    networks.features.encoder.freeze(2)
    frozen = {n for n, p in networks.features.named_parameters() if not p.requires_grad}
    training = TrainingSet(pack, boxes, networks.features.config, None)
    stage = VolumeStage(
        networks, training, training, steps=1, batch=2, learning_rate=1.0, seed=0,
        tune_features=True,
    )  # fmt: skip
    stage.bfloat16 = False
    loss, terms = stage.loss(drawn(stage))
    loss.backward()
    assert {"fine_kl", "pose", "mask", "direction"} <= terms.keys()
    without = {n for n, p in networks.features.named_parameters() if p.grad is None}
    assert frozen and without == frozen
    assert set(stage.module.state_dict()) > {f"features.{name}" for name in frozen}


def test_pose_noise_moves_the_second_view_and_nothing_else(stage, monkeypatch):
    seen = []

    class Captured(Exception):
        pass

    def capture(views, guess, diameter):
        seen.append((views, guess))
        raise Captured

    monkeypatch.setattr(stage.networks.volume, "forward", capture)
    for noise in ((0.0, 0.0), (2.0, 0.01)):
        stage.pose_noise = noise
        with pytest.raises(Captured):
            stage.forward(drawn(stage))
    (exact, guess), (noisy, same_guess) = seen
    assert torch.equal(guess, same_guess)
    for name in ("features", "vote_mean", "vote_covariance"):
        assert torch.equal(getattr(exact, name), getattr(noisy, name))
    assert torch.equal(exact.projection[:, 0], noisy.projection[:, 0])
    for pair in range(2):
        # P = K [R t]: what is left of the noise is rigid and small.
        before, after = (
            _rigid(maps.projection[pair, 1].double().numpy()) for maps in (exact, noisy)
        )
        error = after @ np.linalg.inv(before)
        angle = Rotation.from_matrix(error[:3, :3]).magnitude()
        assert 1e-4 < angle < np.radians(2) + 1e-3
        assert 1e-5 < np.linalg.norm(error[:3, 3]) < 0.0102


def _rigid(P: np.ndarray) -> np.ndarray:
    """The camera's pose (4, 4) in a projection matrix (3, 4)."""
    from scipy.linalg import rq

    K, R = rq(P[:, :3])
    signs = np.diag(np.sign(np.diag(K)))
    K, R = K @ signs, signs @ R
    return make_transform(R, np.linalg.solve(K, P[:, 3]))
