"""Plane sweep against points in space, OpenCV's homographies and a loop."""

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import LINEMOD_K, make_transform, project, transform
from two_view_pose.pose_estimator.networks.plane_sweep import group_correlation, sweep, sweep_pixels

T_VIEW_REF = make_transform(
    Rotation.from_euler("xyz", [0.1, -0.35, 0.2]).as_matrix(), np.array([0.31, -0.05, 0.08])
)


def crop_camera(scale: float, angle: float, shift: tuple[float, float]) -> np.ndarray:
    """LineMOD's camera after an affine map of its image."""
    cosine, sine = scale * np.cos(angle), scale * np.sin(angle)
    affine = np.array([[cosine, -sine, shift[0]], [sine, cosine, shift[1]], [0, 0, 1.0]])
    return affine @ LINEMOD_K


K_REF = crop_camera(0.4, 0.25, (-60, -130))
K_VIEW = crop_camera(0.5, -0.2, (-200, -40))


def tensors(*arrays: np.ndarray) -> list[torch.Tensor]:
    return [torch.from_numpy(a).float()[None] for a in arrays]


@pytest.mark.parametrize("depth", [0.35, 0.9, 2.2])
def test_pixels_match_projected_plane_points(depth):
    depths = torch.full((1, 2, 9, 11), depth)
    pixels, z = sweep_pixels(*tensors(K_REF, K_VIEW, T_VIEW_REF), depths)
    rows, columns = np.indices((9, 11))
    rays = np.stack([columns, rows, np.ones((9, 11))], -1) @ np.linalg.inv(K_REF).T
    seen = transform(T_VIEW_REF, depth * rays)
    for plane in range(2):
        assert np.allclose(z[0, plane], seen[..., 2], atol=1e-5)
        assert np.allclose(pixels[0, plane], project(seen, K_VIEW), atol=2e-3)


def test_plane_matches_opencvs_homography():
    # Four corners of the plane, projected, fix the homography; OpenCV maps the other pixels.
    pixels, _ = sweep_pixels(*tensors(K_REF, K_VIEW, T_VIEW_REF), torch.full((1, 1, 16, 16), 0.8))
    corners = np.array([[0, 0], [15, 0], [0, 15], [15, 15.0]])
    rays = np.concatenate([corners, np.ones((4, 1))], 1) @ np.linalg.inv(K_REF).T
    theirs = project(transform(T_VIEW_REF, 0.8 * rays), K_VIEW)
    H, _ = cv2.findHomography(corners, theirs)
    grid = np.stack(np.meshgrid(np.arange(16.0), np.arange(16.0)), -1)
    expected = cv2.perspectiveTransform(grid, H)
    assert np.allclose(pixels[0, 0], expected, atol=2e-3)


def test_each_pixel_may_have_its_own_plane():
    rng = np.random.default_rng(0)
    depths = torch.from_numpy(rng.uniform(0.5, 1.5, (1, 3, 6, 5))).float()
    together, _ = sweep_pixels(*tensors(K_REF, K_VIEW, T_VIEW_REF), depths)
    for plane, row, column in [(0, 0, 0), (1, 3, 4), (2, 5, 2)]:
        one = depths[:, plane, row, column].reshape(1, 1, 1, 1).expand(1, 1, 6, 5)
        alone, _ = sweep_pixels(*tensors(K_REF, K_VIEW, T_VIEW_REF), one)
        assert torch.allclose(together[0, plane, row, column], alone[0, 0, row, column])


def test_warped_features_are_sampled_at_the_projections():
    # A map of its own pixel coordinates says where it was read.
    ramp = torch.stack(torch.meshgrid(torch.arange(40.0), torch.arange(40.0), indexing="xy"))
    inputs = tensors(K_REF, K_VIEW, T_VIEW_REF)
    depths = torch.linspace(0.5, 1.2, 8).reshape(1, 8, 1, 1).expand(1, 8, 20, 20)
    pixels, _ = sweep_pixels(*inputs, depths)
    middle = pixels[0, 4, 10, 10]
    shifted = inputs[1].clone()
    shifted[0, :2, 2] += 20 - middle  # the crop now shows the sweep's middle
    warped, inside = sweep(ramp[None], inputs[0], shifted, inputs[2], depths)
    pixels, _ = sweep_pixels(inputs[0], shifted, inputs[2], depths)
    within = ((pixels >= 0) & (pixels <= 39)).all(-1)
    assert torch.equal(inside, within) and 0.2 < float(within.float().mean()) < 0.95
    assert torch.allclose(warped[0].movedim(0, -1)[within[0]], pixels[within], atol=1e-3)


def test_points_behind_the_camera_are_invisible():
    behind = make_transform(np.diag([1.0, -1, -1]), np.array([0, 0, 0.3]))
    features = torch.ones(1, 2, 8, 8)
    warped, inside = sweep(features, *tensors(K_REF, K_REF, behind), torch.full((1, 1, 8, 8), 0.9))
    assert not inside.any() and torch.isfinite(warped).all()


def test_gradients_reach_features_but_not_depths():
    features = torch.rand(1, 2, 8, 8, requires_grad=True)
    depths = torch.full((1, 1, 8, 8), 0.9, requires_grad=True)
    same = tensors(K_REF, K_REF, np.eye(4))
    warped, inside = sweep(features, *same, depths)
    assert inside[..., 1:-1, 1:-1].all()
    warped.sum().backward()
    # Seen from the same place every feature is warped where it was.
    assert torch.allclose(warped[:, :, 0], features, atol=1e-3)
    assert torch.allclose(features.grad, torch.ones(1, 2, 8, 8), atol=1e-3)
    assert depths.grad is None


def test_group_correlation_matches_a_loop():
    rng = np.random.default_rng(0)
    reference, warped = rng.normal(size=(2, 6, 3, 3)), rng.normal(size=(2, 6, 4, 3, 3))
    found = group_correlation(torch.from_numpy(reference), torch.from_numpy(warped).float(), 2)
    assert found.shape == (2, 2, 4, 3, 3)
    for sample, group, plane, row, column in np.ndindex(*found.shape):
        channels = slice(3 * group, 3 * group + 3)
        expected = (
            reference[sample, channels, row, column] * warped[sample, channels, plane, row, column]
        ).mean()
        assert float(found[sample, group, plane, row, column]) == pytest.approx(expected, abs=1e-5)
