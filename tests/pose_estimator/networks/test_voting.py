"""Voting on synthetic vector fields whose keypoints are known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from two_view_pose.pose_estimator.networks.voting import Votes, vote_keypoints

SIZE = 32


def field(
    keypoints: np.ndarray, rng: np.random.Generator, *, noise: float = 0.0, outliers: float = 0.0
) -> torch.Tensor:
    """Directions (B, K, 2, H, W) to keypoints (B, K, 2), off by ``noise`` radians.

    A share ``outliers`` of the pixels points anywhere.
    """
    grid = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)))
    offsets = keypoints[..., None, None] - grid
    angles = np.arctan2(offsets[:, :, 1], offsets[:, :, 0])
    angles = angles + noise * rng.normal(size=angles.shape)
    anywhere = rng.random(angles.shape) < outliers
    angles = np.where(anywhere, rng.uniform(0, 2 * np.pi, angles.shape), angles)
    return torch.tensor(np.stack([np.cos(angles), np.sin(angles)], axis=2), dtype=torch.float32)


def for_all_keypoints(weights: torch.Tensor) -> torch.Tensor:
    """Weights (B, H, W) of pixels that count the same for all keypoints, (B, 9, H, W)."""
    return weights[:, None].expand(-1, 9, -1, -1)


def disc(batch: int, radius: float = 9.0) -> torch.Tensor:
    y, x = np.indices((SIZE, SIZE))
    inside = (x - 15) ** 2 + (y - 15) ** 2 < radius**2
    return for_all_keypoints(torch.tensor(inside, dtype=torch.float32).expand(batch, SIZE, SIZE))


def errors(votes: Votes, keypoints: np.ndarray) -> np.ndarray:
    return np.linalg.norm(votes.mean.numpy() - keypoints, axis=-1)


def deviation(votes: Votes) -> np.ndarray:
    """Square root of the covariance's trace, grid pixels."""
    return votes.covariance.diagonal(dim1=-2, dim2=-1).sum(-1).sqrt().numpy()


def assert_sound(votes: Votes) -> None:
    assert torch.isfinite(votes.mean).all() and torch.isfinite(votes.covariance).all()
    assert (torch.linalg.eigvalsh(votes.covariance) > 0).all()
    torch.testing.assert_close(votes.covariance, votes.covariance.transpose(-1, -2))
    assert ((votes.score >= 0) & (votes.score <= 1)).all()


def test_exact_directions_give_the_keypoint():
    rng = np.random.default_rng(0)
    keypoints = rng.uniform(-5, 37, (4, 9, 2))  # also outside the grid
    votes = vote_keypoints(field(keypoints, rng), disc(4))
    assert errors(votes, keypoints).max() < 0.02
    assert votes.score.min() > 0.99
    assert_sound(votes)


def test_robust_to_outliers():
    rng = np.random.default_rng(1)
    keypoints = rng.uniform(4, 28, (4, 9, 2))
    directions = field(keypoints, rng, noise=0.03, outliers=0.4)
    votes = vote_keypoints(directions, disc(4))
    assert errors(votes, keypoints).max() < 0.3
    assert 0.5 < votes.score.mean() < 0.7


def test_pixels_without_weight_do_not_vote():
    """Everything off the object points at another keypoint, with length ten."""
    rng = np.random.default_rng(2)
    keypoints, decoys = rng.uniform(4, 28, (2, 2, 9, 2))
    mask = disc(2)
    directions = torch.where(mask[:, :, None] > 0, field(keypoints, rng), 10 * field(decoys, rng))
    assert errors(vote_keypoints(directions, mask), keypoints).max() < 0.05
    # A weight for each keypoint: half of them weight the background.
    each = mask.clone()
    each[:, ::2] = 1 - each[:, ::2]
    expected = keypoints.copy()
    expected[:, ::2] = decoys[:, ::2]
    assert errors(vote_keypoints(directions, each), expected).max() < 0.05


def test_covariance_grows_with_noise_and_with_fewer_pixels():
    rng = np.random.default_rng(3)
    keypoints = rng.uniform(8, 24, (4, 9, 2))
    by_noise = [
        np.median(deviation(vote_keypoints(field(keypoints, rng, noise=noise), disc(4))))
        for noise in (0.01, 0.05, 0.15)
    ]
    assert by_noise == sorted(by_noise) and by_noise[2] > 3 * by_noise[0]
    directions = field(keypoints, rng, noise=0.05)
    by_size = [
        np.median(deviation(vote_keypoints(directions, disc(4, radius))))
        for radius in (10.0, 4.0, 1.5)
    ]
    assert by_size == sorted(by_size) and by_size[2] > 3 * by_size[0]


def test_covariance_is_elongated_along_the_lines():
    """A keypoint far to the right of the object is known in y and open in x."""
    rng = np.random.default_rng(4)
    keypoints = np.tile([60.0, 15.0], (1, 9, 1))
    covariance = vote_keypoints(field(keypoints, rng, noise=0.03), disc(1, 5.0)).covariance[0]
    assert (covariance[:, 0, 0] > 5 * covariance[:, 1, 1]).all()


def test_covariance_is_not_overconfident():
    rng = np.random.default_rng(5)
    keypoints = rng.uniform(4, 28, (30, 9, 2))
    for radius, noise in ((9.0, 0.05), (4.0, 0.1), (2.0, 0.1)):
        votes = vote_keypoints(field(keypoints, rng, noise=noise, outliers=0.1), disc(30, radius))
        error = votes.mean.double().numpy() - keypoints
        squared = np.einsum(
            "bki,bkij,bkj->bk", error, np.linalg.inv(votes.covariance.double().numpy()), error
        )
        assert np.median(squared) < 2.0


@pytest.mark.parametrize("pixels", [0, 1, 2])
def test_few_pixels_give_large_finite_covariance(pixels: int):
    rng = np.random.default_rng(6)
    keypoints = np.full((2, 9, 2), 20.0)
    weights = torch.zeros(2, SIZE, SIZE)
    for row, column in [(10, 8), (20, 12)][:pixels]:
        weights[:, row, column] = 1.0
    votes = vote_keypoints(field(keypoints, rng, noise=0.02), for_all_keypoints(weights))
    assert_sound(votes)
    many = vote_keypoints(field(keypoints, rng, noise=0.02), disc(2))
    assert deviation(votes).min() > 5 * deviation(many).max()
    if pixels < 2:
        assert votes.score.max() == 0
        assert deviation(votes).min() > SIZE


def test_parallel_directions_give_large_finite_covariance():
    rng = np.random.default_rng(7)
    directions = torch.zeros(1, 9, 2, SIZE, SIZE)
    directions[:, :, 0] = 1.0
    votes = vote_keypoints(directions, disc(1))
    assert_sound(votes)
    assert deviation(votes).min() > SIZE
    far = field(np.full((1, 9, 2), 1e5), rng, noise=1e-4)
    votes = vote_keypoints(far, disc(1))
    assert_sound(votes)
    assert deviation(votes).min() > SIZE


def test_nan_and_zero_directions_give_finite_votes():
    votes = vote_keypoints(torch.full((1, 9, 2, SIZE, SIZE), torch.nan), disc(1))
    assert_sound(votes)
    assert_sound(vote_keypoints(torch.zeros(1, 9, 2, SIZE, SIZE), disc(1)))


def test_votes_are_deterministic():
    rng = np.random.default_rng(8)
    directions = field(rng.uniform(4, 28, (2, 9, 2)), rng, noise=0.1, outliers=0.3)
    weights = torch.tensor(rng.random((2, SIZE, SIZE)), dtype=torch.float32)
    weights = for_all_keypoints(weights)
    first, again = vote_keypoints(directions, weights), vote_keypoints(directions, weights)
    assert torch.equal(first.mean, again.mean)
    assert torch.equal(first.covariance, again.covariance)


def test_invalid_shapes_raise():
    with pytest.raises(ValueError, match="directions"):
        vote_keypoints(torch.zeros(1, 9, 3, 8, 8), torch.zeros(1, 9, 8, 8))
    with pytest.raises(ValueError, match="weights"):
        vote_keypoints(torch.zeros(1, 9, 2, 8, 8), torch.zeros(1, 9, 8, 9))
