"""The volume's training: what its losses hold, where their gradients go, what noise reaches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.dataset import TrainingSet
from two_view_pose.pose_estimator.geometry import make_transform
from two_view_pose.pose_estimator.loader import Batch, collate
from two_view_pose.pose_estimator.losses import pose_loss
from two_view_pose.pose_estimator.networks import PoseNetworks
from two_view_pose.pose_estimator.volume import LevelOutput
from two_view_pose.pose_estimator.volume_stage import VolumeStage, perturb


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
    """The same two pairs each time, told with the stage's noise."""
    draw, rng = stage.drawing(), np.random.default_rng
    return collate([draw(rng(number)) for number in range(2)])


def pose_part(stage: VolumeStage, pairs: Batch) -> torch.Tensor:
    """The pose loss of the fine level alone."""
    out = stage.forward(pairs)
    solution = stage.solve(out["levels"][-1], out)
    return pose_loss(
        solution.rotation, solution.translation, out["T_true"], out["diameter"], alpha=0.3
    )


def test_the_pose_loss_trains_the_features(stage, pairs):
    stage.networks.volume.train()
    lifted: list[torch.Tensor] = []

    def keep(module: torch.nn.Module, arguments: tuple) -> None:
        arguments[0].features.retain_grad()
        lifted.append(arguments[0].features)

    # Where the fine volume stands has no gradient, so it stays where it is.
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


def test_the_loss_is_the_weighted_sum_of_its_parts(stage, pairs):
    for weight, coarse in ((1.0, False), (0.5, True), (0.0, True)):
        stage.pose_weight = weight
        stage.networks.volume.config = replace(stage.networks.volume.config, coarse_pose=coarse)
        with torch.no_grad():
            total, parts = stage.loss(pairs)
        assert ("coarse_pose" in parts) == (coarse and weight > 0)
        assert ("pose" in parts) == (weight > 0)
        expected = sum(
            float(parts[f"{level}_kl"]) * 0.2 + float(parts[f"{level}_distance"]) * 4
            for level in ("coarse", "fine")
        )
        expected += weight * sum(float(parts.get(n, 0)) for n in ("pose", "coarse_pose"))
        assert float(total) == pytest.approx(expected, rel=1e-5)


def test_pose_noise_moves_the_second_view_and_nothing_else(stage, monkeypatch):
    seen = []

    class Heard(Exception):
        pass

    def hear(views, guess, diameter):
        seen.append((views, guess))
        raise Heard

    monkeypatch.setattr(stage.networks.volume, "forward", hear)
    for noise in ((0.0, 0.0), (2.0, 0.01)):
        stage.pose_noise = noise
        with pytest.raises(Heard):
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


def test_errors_of_the_relative_pose_are_even_up_to_their_largest():
    rng = np.random.default_rng(0)
    T = make_transform(Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), np.array([0.2, 0, 0.1]))
    errors = [perturb(T, 2.0, 0.01, rng) @ np.linalg.inv(T) for _ in range(400)]
    vectors = np.array([Rotation.from_matrix(E[:3, :3]).as_rotvec(degrees=True) for E in errors])
    shifts = np.array([E[:3, 3] for E in errors]) * 200
    for values in (vectors, shifts):  # both scaled to 2 at most
        lengths = np.linalg.norm(values, axis=1)
        assert lengths.max() <= 2 + 1e-6
        quartiles = np.quantile(lengths, (0.25, 0.5, 0.75))
        assert np.allclose(quartiles, (0.5, 1.0, 1.5), atol=0.15)
        assert np.abs(values.mean(0)).max() < 0.15  # in all directions
    assert np.array_equal(perturb(T, 0.0, 0.0, rng), T)
