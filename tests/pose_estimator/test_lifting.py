"""Lifting: projections are OpenCV's, votes of two views meet, the joint pose knows the rest."""

import numpy as np
import pytest
import torch
from two_exact_views import (
    CENTRE,
    DIAMETER,
    cube,
    nine_keypoints,
    opencv_pixels,
    second_camera,
    view_maps,
)
from two_view_pose.pose_estimator.lifting import KeypointPrior, lift, prior_evidence
from two_view_pose.pose_estimator.pnp import PnpResult


def test_voxels_fill_the_cube_evenly():
    cells = cube(0.1, 5)[0].numpy() - CENTRE
    assert np.allclose(np.unique(cells[:, 0].round(5)), [-0.08, -0.04, 0, 0.04, 0.08], atol=1e-5)
    assert np.allclose(cells.mean(0), 0, atol=1e-6)
    assert len(np.unique(cells.round(5), axis=0)) == 125


def test_lifted_features_are_those_at_opencvs_projections():
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


def test_voxels_outside_a_view_get_the_initial_value():
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


def test_voxels_behind_a_camera_get_the_initial_value():
    maps = view_maps(nine_keypoints(), features=torch.ones(1, 2, 1, 32, 32))
    behind = torch.tensor([[[0.0, 0.0, -0.5]]])
    lifted, _ = lift(maps, behind, torch.tensor([0.01]), torch.tensor([9.0]), False)
    assert lifted[0, 0, 0, 0] == 9.0


def test_evidence_of_both_views_peaks_at_the_voxel_of_the_votes():
    cells = cube(0.08, 9)
    chosen = np.array([40, 100, 364, 500, 640, 3, 728, 81, 364])
    maps = view_maps(cells[0, chosen].double().numpy())
    _, evidence = lift(maps, cells, torch.tensor([0.16 / 9]), torch.zeros(4), True)
    assert evidence is not None
    assert evidence[0].sum(0).argmax(-1).tolist() == chosen.tolist()


def test_the_evidence_of_a_joint_pose_peaks_where_it_has_the_keypoints():
    cells = cube(0.08, 9)
    chosen = np.array([40, 100, 364, 500, 640, 3, 728, 81, 364])
    points = cells[0, chosen].double().numpy()
    T = np.eye(4)
    T[:3, 3] = CENTRE
    prior = KeypointPrior.from_poses([PnpResult(T, np.eye(6) * 1e-6, 0.0)], [points - CENTRE])
    np.testing.assert_allclose(prior.mean[0].numpy(), points, atol=1e-6)
    evidence = prior_evidence(prior, cells, torch.tensor([0.16 / 9]), torch.tensor([DIAMETER]))
    assert evidence.shape == (1, 9, 729)
    assert evidence[0].argmax(-1).tolist() == chosen.tolist()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_evidence_is_wide_where_the_joint_pose_is_unsure(axis):
    cells = cube(0.08, 9)
    variance = np.full(6, 1e-8)
    variance[3 + axis] = 0.03**2
    T = np.eye(4)
    T[:3, 3] = CENTRE
    pose = PnpResult(T, np.diag(variance), 0.0)
    prior = KeypointPrior.from_poses([pose], [np.zeros((9, 3))])
    evidence = prior_evidence(prior, cells, torch.tensor([0.16 / 9]), torch.tensor([DIAMETER]))
    weight = evidence[0, 0].exp()[:, None]
    spread = ((cells[0] - torch.from_numpy(CENTRE).float()) ** 2 * weight).sum(0) / weight.sum()
    others = [other for other in range(3) if other != axis]
    assert spread[axis] > 2 * spread[others].max()


def test_a_joint_pose_that_knows_nothing_says_nothing():
    T = np.eye(4)
    T[:3, 3] = CENTRE
    prior = KeypointPrior.from_poses([PnpResult(T, np.eye(6), np.inf)], [nine_keypoints() - CENTRE])
    evidence = prior_evidence(
        prior, cube(0.08, 9), torch.tensor([0.16 / 9]), torch.tensor([DIAMETER])
    )
    assert float(evidence.max() - evidence.min()) < 0.02
