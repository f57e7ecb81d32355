"""``early`` with perfect votes and a perfect depth map, and with neither."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from boxes_with_depth import box_depth
from torch import nn
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.pose_estimator.cascade import CascadeConfig, DepthOutput
from two_view_pose.pose_estimator.early_fusion import (
    EarlyFusionEstimator,
    back_project,
    behind_surface,
    read_depth,
)
from two_view_pose.pose_estimator.encoder import PYRAMID_CHANNELS
from two_view_pose.pose_estimator.geometry import (
    LINEMOD_K,
    View,
    grid_matrix,
    make_transform,
    project,
    transform,
)
from two_view_pose.pose_estimator.networks import PoseNetworks
from two_view_pose.pose_estimator.single_view import SingleViewEstimator
from votes import T_WORLD_OBJ, Garbage, PerfectVotes, camera, check_sound, error, view

K_MAP = np.array([[250.0, 0, 31.5], [0, 250, 31.5], [0, 0, 1]])
SHARP = np.tile(np.eye(2) * 1e-4, (9, 1, 1))


def completed(frontend: PerfectVotes, model: ObjectModel) -> PerfectVotes:
    """The frontend, with an encoder's maps and the mask of a box in its views."""
    encode = frontend.encode_view
    generator = torch.Generator().manual_seed(0)

    def encode_view(*arguments, **options):
        shapes = zip(PYRAMID_CHANNELS, (64, 32, 16, 8, 4), strict=True)
        maps = tuple(torch.rand(c, side, side, generator=generator) for c, side in shapes)
        encoded = encode(*arguments, **options)
        T = encoded.view.T_cam_world @ T_WORLD_OBJ
        mask = box_depth(model, T, encoded.K_grid, (32, 32)) > 0
        return replace(encoded, maps=maps, mask=mask.astype(np.float32))

    frontend.encode_view = encode_view
    return frontend


class TrueDepth(nn.Module):
    """Stands in for the cascade: the depth of the one box that there is, far behind it nothing."""

    def __init__(self, model: ObjectModel, T_ref_obj: np.ndarray):
        super().__init__()
        self.model = model
        self.T_ref_obj = T_ref_obj
        self.config = CascadeConfig()
        self.seen = []

    def forward(self, views, guess, diameter):
        self.seen.append((views, guess))
        stride = 2
        K = grid_matrix(stride) @ views.K[0, 0].double().numpy()
        depth = torch.from_numpy(box_depth(self.model, self.T_ref_obj, K, (64, 64)))[None]
        depth = torch.where(depth > 0, depth, torch.tensor(1.2))
        return [DepthOutput(depth, torch.full_like(depth, 1e-6), depth, torch.ones(1), stride)]


def early(networks: PoseNetworks, frontend, monkeypatch, name="brick") -> EarlyFusionEstimator:
    model = networks.objects[name]
    true_depth = TrueDepth(model, camera(20) @ T_WORLD_OBJ)
    monkeypatch.setitem(networks._modules, "cascade", true_depth)
    estimator = EarlyFusionEstimator(networks)
    estimator.frontend = completed(frontend, model)
    return estimator


@pytest.mark.parametrize("name", ["brick", "crate"])
def test_perfect_votes_and_depth_give_the_pose(networks, monkeypatch, name):
    estimator = early(networks, PerfectVotes(networks), monkeypatch, name)
    found = estimator.estimate([view(20), view(65)], name)
    check_sound(found, 2)
    assert error(found, networks, name, 20) < 0.06
    truth = transform(camera(20) @ T_WORLD_OBJ, networks.objects[name].keypoints)
    # The depth is that of the surface in front: right for corners that can be seen, too near for
    # others, which know it.
    short = truth[:, 2] - found.keypoints[:, 2]
    hidden = behind_surface(networks.objects[name], camera(20) @ T_WORLD_OBJ) > 0.02
    assert 1 <= hidden[:8].sum() <= 4 and hidden[8]
    assert (np.abs(short[~hidden]) < 0.01).all() and (short[hidden] > 0.01).all()
    deviation = np.sqrt(found.keypoint_covariance[:, 2, 2])
    assert deviation[hidden].min() > 2 * np.median(deviation[~hidden])
    assert (short[hidden] < 2 * deviation[hidden] + 0.01).all()


@pytest.mark.parametrize("twist", [(0, 1), (1, 0)])
def test_views_that_mean_equivalent_poses_are_reconciled(networks, monkeypatch, twist):
    estimator = early(networks, PerfectVotes(networks, twist), monkeypatch, "crate")
    found = estimator.estimate([view(20), view(65)], "crate")
    assert error(found, networks, "crate", 20) < 0.06


def test_the_cascade_is_told_the_cameras_and_where_the_object_is(networks, monkeypatch):
    estimator = early(networks, PerfectVotes(networks), monkeypatch)
    estimator.estimate([view(20), view(65), view(-10)], "brick")
    model = networks.objects["brick"]
    assert len(networks.cascade.seen) == 2
    for round_number, (views, guess) in enumerate(networks.cascade.seen):
        assert [m.shape for m in views.maps] == [
            (1, 3, c, 128 // s, 128 // s)
            for c, s in zip(PYRAMID_CHANNELS, (2, 4, 8, 16), strict=False)
        ]
        assert abs(float(guess[0]) - (camera(20) @ T_WORLD_OBJ)[2, 3]) < 0.01
        centre = transform(camera(20) @ T_WORLD_OBJ, model.keypoints[-1])
        for number, degrees in enumerate((20, 65, -10)):
            K = views.K[0, number].double().numpy()
            T = views.T_view_ref[0, number].double().numpy()
            truth = (camera(degrees) @ T_WORLD_OBJ)[:3, 3]
            assert np.allclose(transform(T, centre), truth, atol=1e-5)
            # The first crops are (4, -3) picture pixels off, the second where the pose is.
            scale = K[0, 0] / LINEMOD_K[0, 0]
            expected = 63.5 + (round_number == 0) * scale * np.array([-4, 3])
            assert np.allclose(project(truth, K), expected, atol=0.05 if round_number == 0 else 2)


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


def test_beside_the_object_the_nearest_part_of_it_is_read():
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


def test_at_an_edge_one_surface_is_taken_and_the_other_is_doubt():
    depth = np.full((64, 64), 0.8)
    depth[:, 32:] = 0.9
    votes = np.tile([[30.8, 30.0]], (9, 1))
    wide = np.tile(np.eye(2) * 4.0, (9, 1, 1))
    found, variance = read(depth, np.ones((32, 32)), votes, wide)
    assert np.allclose(found, 0.8, atol=1e-9)
    # A Gaussian of deviation 2.06 around 30.8 has 0.37 of itself beyond 31.5; that counts as 3 cm.
    assert np.allclose(np.sqrt(variance), np.sqrt(0.37) * 0.03, rtol=0.05)


def test_no_mask_and_senseless_votes_are_survived():
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


def test_what_lies_behind_the_front(boxes):
    # The brick seen along its z axis: 0.06 m deep, corners in front of each other.
    brick = boxes["brick"]
    T = make_transform(np.eye(3), np.array([0, 0, 20.0]))
    steps = np.linspace(-1, 1, 41)
    front = np.stack(np.meshgrid(steps * 0.06, steps * 0.04, [-0.03]), -1).reshape(-1, 3)
    behind = behind_surface(replace(brick, points=np.concatenate([front, -front])), T)
    z = brick.keypoints[:, 2]
    assert np.allclose(behind[:8], np.where(z[:8] > 0, 0.06, 0.0), atol=2e-3)
    assert behind[8] == pytest.approx(0.03, abs=2e-3)


def test_one_view_answers_as_single_does(networks, monkeypatch):
    estimator = early(networks, PerfectVotes(networks), monkeypatch)
    single = SingleViewEstimator(networks)
    single.frontend = PerfectVotes(networks)
    found, expected = (e.estimate([view(20)], "brick") for e in (estimator, single))
    assert np.array_equal(found.T_cam_obj, expected.T_cam_obj)
    assert networks.cascade.seen == []


def test_garbage_never_gives_nan(networks, monkeypatch):
    estimator = early(networks, Garbage(networks), monkeypatch)
    for number in range(6):
        found = estimator.estimate(
            [view(20), view(20 + 6 * number)], ("brick", "crate")[number % 2]
        )
        check_sound(found, 2)


def test_untrained_networks_answer_noise_with_a_sound_pose(networks):
    rng = np.random.default_rng(0)
    views = [
        View(rng.integers(0, 256, (480, 640, 3), dtype=np.uint8), LINEMOD_K, camera(20)),
        View(np.zeros((360, 500, 3), np.uint8), LINEMOD_K, camera(50)),
    ]
    check_sound(EarlyFusionEstimator(networks).estimate(views, "crate"), 2)
