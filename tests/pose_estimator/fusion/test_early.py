"""``early`` with perfect votes and a perfect depth map, and with neither."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from helpers.true_depth import TrueDepth, with_masks_and_maps
from helpers.votes import T_WORLD_OBJ, PerfectVotes, camera, check_sound, error, view
from two_view_pose.core.geometry import make_transform, project, transform
from two_view_pose.pose_estimator.fusion.early import (
    EarlyFusionEstimator,
    back_project,
    behind_surface,
    read_depth,
)
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.encoder import PYRAMID_CHANNELS

K_MAP = np.array([[250.0, 0, 31.5], [0, 250, 31.5], [0, 0, 1]])
SHARP = np.tile(np.eye(2) * 1e-4, (9, 1, 1))


def early(networks: PoseNetworks, frontend, name="brick") -> EarlyFusionEstimator:
    model = networks.objects[name]
    networks = copy.deepcopy(networks)
    networks.cascade = TrueDepth(model, camera(20) @ T_WORLD_OBJ)
    estimator = EarlyFusionEstimator(networks)
    estimator.frontend = with_masks_and_maps(frontend, model)
    return estimator


@pytest.mark.parametrize("name", ["brick", "crate"])
def test_perfect_votes_and_depth_give_the_pose(networks, name):
    estimator = early(networks, PerfectVotes(networks), name)
    found = estimator.estimate([view(20), view(65)], name)
    check_sound(found, 2)
    assert error(found, networks, name, 20) < 0.09
    truth = transform(camera(20) @ T_WORLD_OBJ, networks.objects[name].keypoints)
    # The depth is that of the surface in front: right for corners that can be seen, too near for
    # others, which know it.
    short = truth[:, 2] - found.keypoints[:, 2]
    hidden = behind_surface(networks.objects[name], camera(20) @ T_WORLD_OBJ) > 0.02
    assert 1 <= hidden[:8].sum() <= 4 and hidden[8]
    assert (np.abs(short[~hidden]) < 0.01).all() and (short[hidden] > 0.01).all()
    deviation = np.sqrt(found.keypoint_covariance[:, 2, 2])
    assert deviation[hidden].min() > 2 * np.median(deviation[~hidden])
    assert (short[hidden] < 4 * deviation[hidden] + 0.01).all()


def test_the_cascade_gets_the_cameras_and_the_depth_of_the_object(networks):
    estimator = early(networks, PerfectVotes(networks))
    estimator.estimate([view(20), view(65), view(-10)], "brick")
    model = networks.objects["brick"]
    [(views, guess)] = estimator.networks.cascade.seen
    assert [m.shape for m in views.maps] == [
        (1, 3, c, 128 // s, 128 // s) for c, s in zip(PYRAMID_CHANNELS, (2, 4, 8, 16), strict=False)
    ]
    assert abs(float(guess[0]) - (camera(20) @ T_WORLD_OBJ)[2, 3]) < 0.01
    center = transform(camera(20) @ T_WORLD_OBJ, model.keypoints[-1])
    for number, degrees in enumerate((20, 65, -10)):
        K = views.K[0, number].double().numpy()
        T = views.T_view_ref[0, number].double().numpy()
        truth = (camera(degrees) @ T_WORLD_OBJ)[:3, 3]
        assert np.allclose(transform(T, center), truth, atol=1e-5)
        # The first crops are (4, -3) image pixels off, the second where the pose is.
        assert np.allclose(project(truth, K), 63.5, atol=2)


def slanted() -> np.ndarray:
    rows, columns = np.indices((64, 64))
    return 0.8 + 0.0008 * columns - 0.0003 * rows


def read(depth, mask, votes, covariance=SHARP, variance=None):
    variance = np.full_like(depth, 1e-6) if variance is None else variance
    return read_depth(depth, variance, mask, votes, covariance, K_MAP)


def test_depth_is_interpolated_between_pixels():
    votes = np.random.default_rng(0).uniform(5, 58, (9, 2))
    depth, variance = read(slanted(), np.ones((32, 32)), votes)
    assert np.allclose(depth, 0.8 + 0.0008 * votes[:, 0] - 0.0003 * votes[:, 1], atol=1e-4)
    assert (variance >= 1e-6).all() and (variance < 4e-6).all()


def test_votes_outside_the_mask_read_its_nearest_pixels():
    mask = np.zeros((32, 32))
    mask[10:20, 10:20] = 0.9  # pixels 20 to 39 of the map
    votes = np.tile([[30.0, 30.0]], (9, 1))
    votes[1], votes[2] = (50, 30), (30, 5)
    depth, variance = read(slanted(), mask, votes)
    assert np.allclose(
        depth[:3], [0.815, 0.8 + 0.0008 * 39 - 0.009, 0.824 - 0.0006 * 10], atol=2e-3
    )
    beside = 0.83 / 250 * np.array([11, 15])
    assert np.allclose(np.sqrt(variance[1:3]), beside, rtol=0.15)
    assert np.sqrt(variance[0]) < 0.002


def test_at_a_depth_edge_the_other_surface_widens_the_variance():
    depth = np.full((64, 64), 0.8)
    depth[:, 32:] = 0.9
    votes = np.tile([[30.8, 30.0]], (9, 1))
    wide = np.tile(np.eye(2) * 4.0, (9, 1, 1))
    found, variance = read(depth, np.ones((32, 32)), votes, wide)
    assert np.allclose(found, 0.8, atol=1e-9)
    # A Gaussian of deviation 2.06 around 30.8 has 0.37 of itself beyond 31.5; that counts as 3 cm.
    assert np.allclose(np.sqrt(variance), np.sqrt(0.37) * 0.03, rtol=0.05)


def test_an_empty_mask_and_outlier_votes_give_finite_depths():
    rng = np.random.default_rng(0)
    for scale in (1.0, 1e3, 1e6):
        votes = rng.normal(32, scale, (9, 2))
        depth, variance = read(slanted(), np.zeros((32, 32)), votes, SHARP * scale)
        assert np.isfinite(depth).all() and np.isfinite(variance).all()
        assert (depth > 0.7).all() and (depth < 0.9).all()


def test_back_projection_and_its_covariance():
    rng = np.random.default_rng(0)
    pixel, depth, deviation = np.array([50.0, 10.0]), 0.85, 0.02
    A = rng.normal(size=(2, 2))
    points, covariance = back_project(
        pixel[None], (A @ A.T)[None], np.array([depth]), np.array([deviation**2]), K_MAP
    )
    assert np.allclose(project(points[0], K_MAP), pixel) and points[0, 2] == pytest.approx(depth)
    pixels = pixel + rng.normal(size=(40000, 2)) @ A.T
    z = depth + deviation * rng.normal(size=40000)
    rays = np.concatenate([pixels, np.ones((len(z), 1))], 1) @ np.linalg.inv(K_MAP).T
    assert np.allclose(covariance[0], np.cov((z[:, None] * rays).T), rtol=0.08, atol=1e-6)


def test_behind_surface_of_a_box(boxes):
    # The brick seen along its z axis: 0.06 m deep, corners in front of each other.
    brick = boxes["brick"]
    T = make_transform(np.eye(3), np.array([0, 0, 20.0]))
    steps = np.linspace(-1, 1, 41)
    front = np.stack(np.meshgrid(steps * 0.06, steps * 0.04, [-0.03]), -1).reshape(-1, 3)
    behind = behind_surface(replace(brick, points=np.concatenate([front, -front])), T)
    z = brick.keypoints[:, 2]
    assert np.allclose(behind[:8], np.where(z[:8] > 0, 0.06, 0.0), atol=2e-3)
    assert behind[8] == pytest.approx(0.03, abs=2e-3)
