"""Soft RANSAC against SciPy's alignment, singular values and finite differences."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.solvers.soft_ransac import SoftRansacConfig, kabsch, soft_ransac


def keypoints(rng: np.random.Generator, count: int = 9) -> np.ndarray:
    """Keypoints of an object some 0.2 m across, the last one its center."""
    points = rng.uniform(-0.07, 0.07, (count, 3))
    points[-1] = 0.0
    return points


def poses(rng: np.random.Generator, batch: int) -> tuple[np.ndarray, np.ndarray]:
    translations = rng.normal(size=(batch, 3)) * 0.1 + [0.0, 0.0, 0.9]
    return Rotation.random(batch, rng=rng).as_matrix(), translations


def moved(points: np.ndarray, rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
    return points @ rotations.transpose(0, 2, 1) + translations[:, None]


def scipy_fit(model: np.ndarray, points: np.ndarray) -> np.ndarray:
    return Rotation.align_vectors(points - points.mean(0), model - model.mean(0))[0].as_matrix()


def test_three_points_match_scipys_alignment():
    """With three keypoints there is one hypothesis, which the closed form alone decides."""
    rng = np.random.default_rng(2)
    model = rng.normal(size=(50, 3, 3)) * 0.05
    predicted = rng.normal(size=(50, 3, 3)) * 0.05 + [0.0, 0.0, 1.0]
    result = soft_ransac(torch.tensor(model), torch.tensor(predicted))
    for i in range(50):
        expected = scipy_fit(model[i], predicted[i])
        np.testing.assert_allclose(result.rotation[i], expected, atol=1e-6)
        shift = predicted[i].mean(0) - expected @ model[i].mean(0)
        np.testing.assert_allclose(result.translation[i], shift, atol=1e-6)


def test_weighted_average_matches_the_equations():
    """All 84 fits by SciPy, scored, normalized and averaged as the equations say."""
    rng = np.random.default_rng(13)
    model = keypoints(rng)
    rotations, translations = poses(rng, 1)
    predicted = moved(model, rotations, translations)[0] + rng.normal(size=(9, 3)) * 0.01
    config = SoftRansacConfig(gamma1=400.0, gamma2=0.012)
    scores, fits, centers = [], [], []
    for triple in combinations(range(9), 3):
        corners = list(triple)
        fit = scipy_fit(model[corners], predicted[corners])
        shift = predicted[corners].mean(0) - fit @ model[corners].mean(0)
        distances = np.linalg.norm(model @ fit.T + shift - predicted, axis=1)
        scores.append((1 / (1 + np.exp(-400.0 * (0.012 - distances)))).sum())
        fits.append(fit)
        centers.append(fit @ model.mean(0) + shift)
    alpha = np.array(scores) / np.sum(scores)
    mean = Rotation.from_matrix(fits).mean(weights=alpha).as_matrix()
    result = soft_ransac(torch.tensor(model), torch.tensor(predicted)[None], config)
    np.testing.assert_allclose(result.weights[0], alpha, rtol=1e-5)
    # SciPy's mean maximizes the same trace.
    np.testing.assert_allclose(result.rotation[0], mean, atol=1e-6)
    np.testing.assert_allclose(
        result.translation[0], alpha @ np.array(centers) - mean @ model.mean(0), atol=1e-6
    )


@pytest.mark.parametrize("sharpness", [1.0, 8.0])
def test_robust_to_gross_outliers(sharpness: float):
    rng = np.random.default_rng(4)
    model = keypoints(rng)
    rotations, translations = poses(rng, 40)
    truth = moved(model, rotations, translations)
    predicted = truth + rng.normal(size=truth.shape) * 0.002
    predicted[:, :3] += rng.normal(size=(40, 3, 3)) * 0.15

    def error(rotation: torch.Tensor, translation: torch.Tensor) -> float:
        fitted = moved(model, rotation.numpy(), translation.numpy())
        return float(np.median(np.linalg.norm(fitted - truth, axis=2).mean(1)))

    config = SoftRansacConfig(sharpness=sharpness)
    result = soft_ransac(torch.tensor(model), torch.tensor(predicted), config)
    assert error(result.rotation, result.translation) < 0.005
    assert error(*kabsch(torch.tensor(model), torch.tensor(predicted))) > 0.03


def test_gradient_matches_finite_differences():
    rng = np.random.default_rng(5)
    model = torch.tensor(keypoints(rng, 5))
    rotations, translations = poses(rng, 2)
    predicted = moved(model.numpy(), rotations, translations) + rng.normal(size=(2, 5, 3)) * 0.01
    weights = torch.tensor(rng.uniform(0.5, 1.5, (2, 5)), requires_grad=True)
    config = SoftRansacConfig(gamma1=100.0, gamma2=torch.tensor([0.02, 0.01]), sharpness=2.0)

    def solve(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        result = soft_ransac(model, points, config)
        return result.rotation, result.translation

    points = torch.tensor(predicted, requires_grad=True)
    assert torch.autograd.gradcheck(solve, points, eps=1e-7, atol=1e-4)
    assert torch.autograd.gradcheck(
        lambda p, w: kabsch(model, p, w), (points, weights), eps=1e-7, atol=1e-4
    )


def test_collinear_model_triples_have_zero_weight():
    rng = np.random.default_rng(7)
    model = keypoints(rng, 6)
    model[2] = 0.5 * (model[0] + model[1])
    rotations, translations = poses(rng, 1)
    predicted = moved(model, rotations, translations) + rng.normal(size=(1, 6, 3)) * 0.005
    result = soft_ransac(torch.tensor(model), torch.tensor(predicted))
    assert result.weights[0, list(combinations(range(6), 3)).index((0, 1, 2))] == 0


def test_half_precision_and_autocast_give_float32():
    rng = np.random.default_rng(8)
    model = keypoints(rng)
    predicted = moved(model, *poses(rng, 4))
    exact = soft_ransac(torch.tensor(model), torch.tensor(predicted))
    with torch.autocast("cpu", torch.bfloat16):
        result = soft_ransac(torch.tensor(model).float(), torch.tensor(predicted).float())
    assert result.rotation.dtype == torch.float32
    torch.testing.assert_close(result.rotation, exact.rotation.float(), atol=1e-4, rtol=0)
    rough = soft_ransac(torch.tensor(model).bfloat16(), torch.tensor(predicted).bfloat16())
    assert rough.rotation.dtype == torch.float32


def test_inlier_test_scales_with_the_diameter():
    """A scene twice the size gives the same rotation and twice the translation."""
    rng = np.random.default_rng(9)
    model = torch.tensor(keypoints(rng))
    rotations, translations = poses(rng, 2)
    predicted = torch.tensor(moved(model.numpy(), rotations, translations))
    predicted += torch.tensor(rng.normal(size=(2, 9, 3)) * 0.01)
    diameters = torch.tensor([0.15, 0.3], dtype=torch.float64)
    once = soft_ransac(model, predicted, SoftRansacConfig.for_diameter(diameters))
    twice = soft_ransac(2 * model, 2 * predicted, SoftRansacConfig.for_diameter(2 * diameters))
    torch.testing.assert_close(twice.rotation, once.rotation)
    torch.testing.assert_close(twice.translation, 2 * once.translation)


def test_invalid_inputs_raise():
    model = torch.rand(9, 3)
    with pytest.raises(ValueError, match="predicted"):
        soft_ransac(model, torch.rand(9, 3))
    with pytest.raises(ValueError, match="model_points"):
        soft_ransac(model, torch.rand(2, 8, 3))
    with pytest.raises(ValueError, match="one line"):
        soft_ransac(torch.linspace(0, 1, 9)[:, None].expand(9, 3), torch.rand(2, 9, 3))
