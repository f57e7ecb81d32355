"""The three solvers against SciPy's alignment and a RANSAC that loops."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.methods import SOLVERS
from two_view_pose.pose_estimator.solvers.rigid import solve, solve_pose

DIAMETER = 0.2


def scene(seed: int, batch: int = 6) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """Model keypoints (9, 3) and where poses put them, (B, 9, 3)."""
    rng = np.random.default_rng(seed)
    model = rng.uniform(-0.07, 0.07, (9, 3))
    rotations = Rotation.random(batch, rng=rng).as_matrix()
    shifts = rng.normal(size=(batch, 1, 3)) * 0.1 + [0, 0, 0.9]
    return model, model @ rotations.transpose(0, 2, 1) + shifts, rng


def fit(model: np.ndarray, points: np.ndarray, weights=None) -> tuple[np.ndarray, np.ndarray]:
    """SciPy's least-squares motion."""
    weights = np.ones(len(model)) if weights is None else weights
    a, b = (np.average(x, axis=0, weights=weights) for x in (points, model))
    rotation = Rotation.align_vectors(points - a, model - b, weights=weights)[0].as_matrix()
    return rotation, a - rotation @ b


def distance(model: np.ndarray, motion, truth: np.ndarray) -> np.ndarray:
    """Mean distance of the keypoints under each motion from the truth, (B,)."""
    moved = model @ motion.rotation.numpy().transpose(0, 2, 1) + motion.translation.numpy()[:, None]
    return np.linalg.norm(moved - truth, axis=-1).mean(1)


def run(model: np.ndarray, predicted: np.ndarray, solver: str):
    return solve(torch.from_numpy(model), torch.from_numpy(predicted), DIAMETER, solver)


@pytest.mark.parametrize("solver", SOLVERS)
def test_exact_without_noise(solver):
    model, truth, _ = scene(0)
    assert distance(model, run(model, truth, solver), truth).max() < 1e-6


@pytest.mark.parametrize("solver", SOLVERS)
def test_batch_equals_single_poses(solver):
    model, truth, rng = scene(1)
    predicted = truth + rng.normal(0, 0.01, truth.shape)
    diameters = torch.linspace(0.1, 0.3, len(truth))
    together = solve(torch.from_numpy(model), torch.from_numpy(predicted), diameters, solver)
    for i, diameter in enumerate(diameters):
        alone = solve(
            torch.from_numpy(model), torch.from_numpy(predicted[i : i + 1]), float(diameter), solver
        )
        torch.testing.assert_close(alone.rotation[0], together.rotation[i], rtol=0, atol=1e-6)
        torch.testing.assert_close(alone.translation[0], together.translation[i], rtol=0, atol=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
def test_one_model_for_each_pose(solver):
    """Poses of several objects at once, one of which has keypoints on a line."""
    models, predicted = [], []
    for seed in range(4):
        model, truth, rng = scene(20 + seed, batch=1)
        if seed == 2:
            model[3] = (model[0] + model[1]) / 2
        models.append(model)
        predicted.append(truth[0] + rng.normal(0, 0.02, (9, 3)))
    together = run(np.stack(models), np.stack(predicted), solver)
    for i, (model, points) in enumerate(zip(models, predicted, strict=True)):
        alone = run(model, points[None], solver)
        np.testing.assert_allclose(together.rotation[i], alone.rotation[0], atol=1e-12)
        np.testing.assert_allclose(together.translation[i], alone.translation[0], atol=1e-12)


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_poses(solver):
    model, truth, _ = scene(30)
    found = run(model, truth[:0], solver)
    assert found.rotation.shape == (0, 3, 3) and found.translation.shape == (0, 3)


def test_kabsch_is_the_least_squares_fit():
    model, truth, rng = scene(2)
    predicted = truth + rng.normal(0, 0.01, truth.shape)
    found = run(model, predicted, "kabsch")
    for i in range(6):
        rotation, translation = fit(model, predicted[i])
        np.testing.assert_allclose(found.rotation[i], rotation, atol=1e-6)
        np.testing.assert_allclose(found.translation[i], translation, atol=1e-6)


def looping_ransac(model: np.ndarray, predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every triple in turn; the most inliers win, then the least truncated squared distances."""
    best, chosen = (-1, np.inf), None
    for corners in map(list, combinations(range(9), 3)):
        rotation, translation = fit(model[corners], predicted[corners])
        distances = np.linalg.norm(model @ rotation.T + translation - predicted, axis=1)
        inliers = distances < 0.2 * DIAMETER
        score = (inliers.sum(), -(np.minimum(distances, 0.2 * DIAMETER) ** 2).sum())
        if chosen is None or score > best:
            best, chosen = score, inliers
    return fit(model[chosen], predicted[chosen])


def test_hard_matches_a_looping_ransac():
    model, truth, rng = scene(3)
    predicted = truth + rng.normal(0, 0.012, truth.shape)
    predicted[:, :3] += rng.normal(0, 0.1, (6, 3, 3))
    found = run(model, predicted, "hard")
    for i in range(6):
        rotation, translation = looping_ransac(model, predicted[i])
        np.testing.assert_allclose(found.rotation[i], rotation, atol=1e-5)
        np.testing.assert_allclose(found.translation[i], translation, atol=1e-5)


@pytest.mark.parametrize(("solver", "robust"), [("soft", True), ("hard", True), ("kabsch", False)])
def test_gross_outliers(solver, robust):
    model, truth, rng = scene(4, batch=40)
    predicted = truth + rng.normal(0, 0.003, truth.shape)
    predicted[:, 2:5] += rng.normal(0, 0.15, (40, 3, 3))
    errors = distance(model, run(model, predicted, solver), truth)
    assert (errors < 0.1 * DIAMETER).all() == robust


@pytest.mark.parametrize("solver", ["soft", "kabsch"])
def test_gradient_matches_finite_differences(solver):
    model, truth, rng = scene(6, batch=2)
    predicted = torch.tensor(truth + rng.normal(0, 0.01, truth.shape), requires_grad=True)

    def pose(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return tuple(solve(torch.from_numpy(model), points, DIAMETER, solver))

    assert torch.autograd.gradcheck(pose, predicted, eps=1e-7, atol=1e-4)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("kind", ["coincident", "collinear", "mirrored", "far apart"])
def test_degenerate_keypoints_give_finite_rotations(solver, kind):
    model, truth, rng = scene(7)
    predicted = truth.copy()
    if kind == "coincident":
        predicted[:] = [0, 0, 1.0]
    if kind == "collinear":
        predicted[:] = np.linspace(0, 0.2, 9)[:, None]
    if kind == "mirrored":
        predicted[:] = model * [-1, 1, 1]
    if kind == "far apart":
        predicted += rng.normal(0, 10, predicted.shape)
    points = torch.from_numpy(predicted).float().requires_grad_()
    found = solve(torch.from_numpy(model).float(), points, DIAMETER, solver)
    (found.rotation.sum() + found.translation.square().sum()).backward()
    assert torch.isfinite(points.grad).all() and torch.isfinite(found.translation).all()
    torch.testing.assert_close(torch.linalg.det(found.rotation), torch.ones(6))


@pytest.mark.parametrize("solver", SOLVERS)
def test_solve_pose_of_arrays(solver):
    model, truth, _ = scene(8)
    T = solve_pose(model, truth[0], DIAMETER, solver)
    assert T.dtype == np.float64
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(model @ T[:3, :3].T + T[:3, 3], truth[0], atol=1e-5)


def test_inference_before_training():
    model, truth, _ = scene(9)
    # Ten keypoints: no other test has left anything in the caches.
    model, truth = (np.concatenate([a, a[..., :1, :] + 0.05], -2) for a in (model, truth))
    with torch.inference_mode():
        run(model, truth, "soft")
    points = torch.from_numpy(truth).requires_grad_()
    solve(torch.from_numpy(model), points, DIAMETER).translation.sum().backward()
    assert torch.isfinite(points.grad).all()


def test_invalid_inputs_raise():
    model, truth, _ = scene(10)
    with pytest.raises(
        ValueError, match="unknown solver 'best'; there are soft, soft-mean, kabsch, hard"
    ):
        run(model, truth, "best")
    for solver in SOLVERS:
        with pytest.raises(ValueError, match="model_points must be"):
            run(model[:8], truth, solver)
