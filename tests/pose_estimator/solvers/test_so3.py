"""The nearest rotation against singular values and finite differences."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.solvers.so3 import project_to_so3


def by_singular_values(matrices: np.ndarray) -> np.ndarray:
    u, _, vt = np.linalg.svd(matrices)
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    return u @ vt


def test_matches_the_svd():
    rng = np.random.default_rng(0)
    matrices = rng.normal(size=(5, 40, 3, 3))  # half of them are reflections
    assert 60 < (np.linalg.det(matrices) < 0).sum() < 140
    found = project_to_so3(torch.from_numpy(matrices))
    np.testing.assert_allclose(found, by_singular_values(matrices), atol=1e-9)
    single = project_to_so3(torch.from_numpy(matrices).float())
    assert np.median(np.abs(single.numpy() - found.numpy())) < 1e-6


def test_rank_two_matrices():
    """Keypoints in a plane leave one singular value of zero."""
    rng = np.random.default_rng(1)
    rotations = Rotation.random(50, rng=rng).as_matrix()
    matrices = rotations @ np.diag([0.3, 0.1, 0.0])
    np.testing.assert_allclose(project_to_so3(torch.from_numpy(matrices)), rotations, atol=1e-9)


def test_degenerate_matrices_give_rotations():
    """Zero, rank one, and a point reflection."""
    line = torch.outer(torch.tensor([0.0, 0.6, 0.8]), torch.tensor([1.0, 0.0, 0.0]))
    found = project_to_so3(torch.stack([torch.zeros(3, 3), line, -torch.eye(3)]))
    torch.testing.assert_close(found @ found.mT, torch.eye(3).expand(3, 3, 3))
    torch.testing.assert_close(torch.linalg.det(found), torch.ones(3))
    torch.testing.assert_close((found[1] * line).sum(), torch.tensor(1.0))


def test_gradient_at_equal_singular_values():
    matrices = torch.stack(
        [torch.eye(3), 0.5 * torch.eye(3), torch.diag(torch.tensor([2.0, 1, -0.1]))]
    )
    matrices = matrices.double().requires_grad_()
    assert torch.autograd.gradcheck(project_to_so3, matrices, atol=1e-5)
