"""The volume: projections match OpenCV's, votes are triangulated, gradients reach the features."""

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import make_transform
from two_view_pose.pose_estimator.networks.volume import (
    PRESETS,
    ViewMaps,
    VolumeNet,
    lift,
    voxel_centers,
)
from two_view_pose.pose_estimator.solvers.soft_ransac import SoftRansacConfig, soft_ransac
from two_view_pose.pose_estimator.training.losses import pose_loss

K_GRID = np.array([[114.0, 0, 15.0], [0, 113.0, 16.2], [0, 0, 1]])
DIAMETER = 0.16
CENTER = np.array([0.02, -0.03, 0.95])


def second_camera() -> np.ndarray:
    """T_second_ref: 30 degrees around the object, so that it stays in the middle."""
    rotation = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    return make_transform(rotation, np.array([0.01, -0.02, 1.0]) - rotation @ CENTER)


def opencv_pixels(points: np.ndarray, T_cam_ref: np.ndarray) -> np.ndarray:
    rvec, _ = cv2.Rodrigues(T_cam_ref[:3, :3])
    pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), rvec, T_cam_ref[:3, 3], K_GRID, None)
    return pixels[:, 0]


def view_maps(
    keypoints: np.ndarray, deviation: float = 0.3, features: torch.Tensor | None = None
) -> ViewMaps:
    """Two views whose votes are exact."""
    cameras = [np.eye(4), second_camera()]
    votes = np.stack([opencv_pixels(keypoints, T) for T in cameras])
    if features is None:
        features = torch.zeros(1, 2, 4, 32, 32)
    return ViewMaps(
        features=features,
        projection=torch.from_numpy(np.stack([K_GRID @ T[:3] for T in cameras])).float()[None],
        vote_mean=torch.from_numpy(votes).float()[None],
        vote_covariance=torch.eye(2).expand(1, 2, 9, 2, 2) * deviation**2,
    )


def nine_keypoints() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.vstack([CENTER + rng.uniform(-0.05, 0.05, (8, 3)), CENTER])


def cube(half: float, count: int) -> torch.Tensor:
    return voxel_centers(torch.from_numpy(CENTER).float()[None], torch.tensor([half]), count)


def test_voxel_centers_are_regular():
    cells = cube(0.1, 5)[0].numpy() - CENTER
    assert np.allclose(np.unique(cells[:, 0].round(5)), [-0.08, -0.04, 0, 0.04, 0.08], atol=1e-5)
    assert np.allclose(cells.mean(0), 0, atol=1e-6)
    assert len(np.unique(cells.round(5), axis=0)) == 125


def test_lifted_features_match_opencvs_projections():
    # A ramp reads back the pixel at which it was sampled.
    rows, columns = torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="ij")
    features = torch.stack([columns, rows])[None, None].expand(1, 2, 2, 32, 32)
    maps = view_maps(nine_keypoints(), features=features)
    cells = cube(0.08, 6)
    lifted, evidence = lift(maps, cells, torch.tensor([0.027]), torch.full((2,), -1.0), False)
    assert evidence is None
    for view, T in enumerate((np.eye(4), second_camera())):
        expected = opencv_pixels(cells[0].double().numpy(), T)
        assert (expected > 0).all() and (expected < 31).all()
        assert np.allclose(lifted[0, view].T.numpy(), expected, atol=1e-3)


def test_voxels_outside_a_view_get_the_learned_value():
    maps = view_maps(nine_keypoints(), features=torch.ones(1, 2, 3, 32, 32))
    cells = cube(0.5, 7)
    outside = torch.tensor([5.0, 6.0, 7.0])
    lifted, _ = lift(maps, cells, torch.tensor([0.14]), outside, False)
    pixels = opencv_pixels(cells[0].double().numpy(), np.eye(4))
    seen = ((pixels >= 0) & (pixels <= 31)).all(1)
    assert 0 < seen.sum() < len(seen)
    values = lifted[0, 0].T
    assert torch.allclose(values[torch.from_numpy(seen)], torch.ones(3))
    assert torch.equal(values[torch.from_numpy(~seen)], outside.expand(int((~seen).sum()), 3))


def test_voxels_behind_a_camera_get_the_learned_value():
    maps = view_maps(nine_keypoints(), features=torch.ones(1, 2, 1, 32, 32))
    behind = torch.tensor([[[0.0, 0.0, -0.5]]])
    lifted, _ = lift(maps, behind, torch.tensor([0.01]), torch.tensor([9.0]), False)
    assert lifted[0, 0, 0, 0] == 9.0


def test_evidence_peaks_at_the_voted_voxel():
    cells = cube(0.08, 9)
    chosen = np.array([40, 100, 364, 500, 640, 3, 728, 81, 364])
    maps = view_maps(cells[0, chosen].double().numpy())
    _, evidence = lift(maps, cells, torch.tensor([0.16 / 9]), torch.zeros(4), True)
    assert evidence is not None
    assert evidence[0].sum(0).argmax(-1).tolist() == chosen.tolist()


def net_that_trusts_votes() -> VolumeNet:
    net = VolumeNet(4)
    for volume in (net.coarse, net.fine):
        torch.nn.init.zeros_(volume.output.weight)
    return net.eval()


@pytest.mark.slow
@pytest.mark.parametrize("deviation", [0.05, 0.3, 0.6])
@pytest.mark.parametrize("bfloat16", [False, True])
def test_exact_votes_are_triangulated_to_a_fraction_of_a_voxel(deviation, bfloat16):
    keypoints = nine_keypoints()
    guess = torch.from_numpy(CENTER + 0.015).float()[None]
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
        coarse, fine = net_that_trusts_votes()(
            view_maps(keypoints, deviation), guess, torch.tensor([DIAMETER])
        )
    for level, limit in ((coarse, 0.5), (fine, 0.35)):
        assert level.keypoints.dtype == torch.float32
        error = np.linalg.norm(level.keypoints[0].numpy() - keypoints, axis=1)
        assert error.mean() < limit * float(level.cell_size)


def test_two_views_reduce_the_depth_covariance():
    keypoints = nine_keypoints()
    maps = view_maps(keypoints)
    single = ViewMaps(*(part[:, :1] for part in maps))
    guess = torch.from_numpy(CENTER).float()[None]
    with torch.no_grad():
        pair, alone = (
            net_that_trusts_votes()(m, guess, torch.tensor([DIAMETER]))[-1] for m in (maps, single)
        )
    assert (pair.covariance[0, :, 2, 2] < 0.5 * alone.covariance[0, :, 2, 2]).all()
    assert torch.isfinite(alone.keypoints).all()


def test_three_views():
    maps = view_maps(nine_keypoints())
    third = ViewMaps(*(torch.cat([part, part[:, 1:]], 1) for part in maps))
    guess = torch.from_numpy(CENTER).float()[None]
    with torch.no_grad():
        fine = net_that_trusts_votes()(third, guess, torch.tensor([DIAMETER]))[-1]
    error = np.linalg.norm(fine.keypoints[0].numpy() - nine_keypoints(), axis=1)
    assert error.mean() < 0.01


def test_the_pose_loss_reaches_the_lifted_features():
    torch.manual_seed(0)
    keypoints = nine_keypoints()
    features = torch.randn(1, 2, 4, 32, 32, requires_grad=True)
    net = VolumeNet(4).train()
    levels = net(
        view_maps(keypoints, features=features),
        torch.from_numpy(CENTER).float()[None],
        torch.tensor([DIAMETER]),
    )
    model = torch.from_numpy(keypoints - CENTER).float()
    solution = soft_ransac(model, levels[-1].keypoints, SoftRansacConfig.for_diameter(DIAMETER))
    truth = torch.from_numpy(make_transform(np.eye(3), CENTER + 0.01)).float()[None]
    loss = pose_loss(
        solution.rotation, solution.translation, truth, torch.tensor([DIAMETER]), alpha=0.3
    )
    loss.backward()
    assert features.grad is not None
    assert torch.isfinite(features.grad).all() and features.grad.abs().sum() > 0
    assert net.fine.outside.grad is not None


def test_paper_preset_grids():
    diameter = torch.tensor([0.2])
    paper = PRESETS["paper"]
    count, half = paper.coarse.shape(diameter)
    assert count == 60 and float(half) == pytest.approx(0.3)
    assert 2 * float(half) / count == pytest.approx(0.01)
    count, half = paper.fine.shape(diameter)
    assert 2 * float(half) / count == pytest.approx(0.005, rel=0.02)
    assert 2 * float(half) > 0.2
    assert not paper.evidence and paper.coarse_pose
    # Voxels keep their size also where a batch mixes objects: its volumes fit the largest.
    count, half = paper.fine.shape(torch.tensor([0.1, 0.2831, 0.15]))
    assert torch.allclose(2 * half / count, torch.full((3,), 0.005))
    assert 1.3 * 0.2831 <= 2 * float(half[0]) < 1.3 * 0.2831 + 0.0051


def test_fast_preset_scales_with_the_diameter():
    fast = PRESETS["fast"]
    for level in (fast.coarse, fast.fine):
        small, large = level.shape(torch.tensor([0.1])), level.shape(torch.tensor([0.2]))
        assert small[0] == large[0] <= 16
        assert float(large[1]) == pytest.approx(2 * float(small[1]))


def test_the_preset_paper_has_the_papers_settings():
    """What ``fast`` has otherwise is listed in docs/deviations.md."""
    paper, fast = PRESETS["paper"], PRESETS["fast"]
    diameter = torch.tensor([0.2])
    count, half = paper.coarse.shape(diameter)
    assert count == 60 and float(half) == pytest.approx(0.3)
    count, half = paper.fine.shape(diameter)
    assert 2 * float(half) / count == pytest.approx(0.005) and float(half) >= 0.5 * 0.2
    assert paper.coarse_pose and paper.predicted_first and paper.solver == "soft-mean"
    assert not paper.evidence
    # Nothing but features of both views enters the 3D network, of 32 hidden channels.
    net = VolumeNet(32, paper)
    assert net.coarse.trunk[0].in_channels == 64 and net.coarse.trunk[0].out_channels == 32
    names = ("coarse", "fine", "evidence", "coarse_pose", "predicted_first", "solver")
    assert all(getattr(paper, name) != getattr(fast, name) for name in names)
