"""Errors of a relative pose: of the requested size, in all directions."""

import numpy as np
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import make_transform
from two_view_pose.core.pose_noise import perturb_relative_pose

T = make_transform(Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), np.array([0.2, 0, 0.1]))


def errors(uniform: bool) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vectors and shifts (400, 3) of errors of 2 degrees and 10 mm, scaled to 2."""
    rng = np.random.default_rng(0)
    found = [
        perturb_relative_pose(T, 2.0, 0.01, rng, uniform=uniform) @ np.linalg.inv(T)
        for _ in range(400)
    ]
    rotations = np.array([Rotation.from_matrix(E[:3, :3]).as_rotvec(degrees=True) for E in found])
    return rotations, 200 * np.array([E[:3, 3] for E in found])


def test_uniform_errors_are_up_to_the_given_size():
    for values in errors(uniform=True):
        lengths = np.linalg.norm(values, axis=1)
        assert lengths.max() <= 2 + 1e-6
        quartiles = np.quantile(lengths, (0.25, 0.5, 0.75))
        assert np.allclose(quartiles, (0.5, 1.0, 1.5), atol=0.15)
        assert np.abs(values.mean(0)).max() < 0.15


def test_errors_have_the_given_size():
    for values in errors(uniform=False):
        assert np.allclose(np.linalg.norm(values, axis=1), 2)
        assert np.abs(values.mean(0)).max() < 0.2
    assert np.array_equal(perturb_relative_pose(T, 0.0, 0.0, np.random.default_rng(0)), T)
