"""``rgbd`` with perfect 2D votes and ideal depth, and a network that fits what it is given."""

import copy
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.boxes import box_depth
from scipy.spatial.transform import Rotation
from torch import nn
from two_view_pose.core.errors import InputError
from two_view_pose.core.geometry import (
    LINEMOD_K,
    View,
    crop_matrix,
    grid_matrix,
    make_transform,
    project,
    transform,
)
from two_view_pose.pose_estimator.fusion.depth_agreement import agrees, check_depth_use, enough
from two_view_pose.pose_estimator.fusion.frontend import EncodedView
from two_view_pose.pose_estimator.fusion.rgbd import RgbdEstimator
from two_view_pose.pose_estimator.fusion.single import SingleViewEstimator
from two_view_pose.pose_estimator.input_files import DepthMap, read_depth_map
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.point_voting import PointConfig, PointVotes
from two_view_pose.pose_estimator.types import Roi

T_CAM_OBJ = make_transform(
    Rotation.from_euler("xyz", [-2.0, 0.4, 0.3]).as_matrix(), np.array([0.08, -0.05, 0.85])
)


class Votes2D:
    """Answers for the 2D part from the truth; records the regions it was given."""

    def __init__(self, networks: PoseNetworks):
        self.networks = networks
        self.rois: list[Roi | None] = []

    def encode_view(self, view, index, roi=None) -> EncodedView:
        self.rois.append(roi)
        model = list(self.networks.objects.values())[index]
        config = self.networks.features.config
        center = project(T_CAM_OBJ[:3, 3], view.K) + np.array([6, -4])
        found = roi or Roi(center, 1.5 * model.diameter * view.K[0, 0] / T_CAM_OBJ[2, 3], 0.9)
        to_grid = grid_matrix(config.stride) @ crop_matrix(found.center, found.side, config.crop)
        K_grid = to_grid @ view.K
        mask = box_depth(model, T_CAM_OBJ, K_grid, (config.grid, config.grid)) > 0
        return EncodedView(
            view=view,
            roi=found,
            K_grid=K_grid,
            to_image=np.linalg.inv(to_grid),
            volume=torch.zeros(config.volume_channels, config.grid, config.grid),
            decoder=torch.zeros(config.width, config.grid, config.grid),
            maps=(),
            vote_mean=project(transform(T_CAM_OBJ, model.keypoints), K_grid),
            vote_covariance=np.tile(np.eye(2) * 0.04, (9, 1, 1)),
            vote_score=np.ones(9),
            mask=mask.astype(float),
        )

    def encode(self, targets) -> list[EncodedView]:
        return [self.encode_view(*target) for target in targets]

    def encode_rotated(self, targets, rolls) -> list[list[EncodedView]]:
        return [[self.encode_view(*t)] * len(own) for t, own in zip(targets, rolls, strict=True)]


class FitsCenter(nn.Module):
    """Stands in for the point network: knows the true pose, but places it where the cloud is."""

    config = PointConfig(points=128)

    def __init__(self, objects):
        super().__init__()
        self.objects = list(objects.values())
        self.clouds: list[np.ndarray] = []

    def forward(self, maps, cloud, index, diameter):
        model = self.objects[int(index[0])]
        points = (cloud.xyz[0] @ cloud.R_crop_cam[0])[cloud.valid[0]].double().numpy()
        self.clouds.append(points)
        rays = np.concatenate([project(points, LINEMOD_K), np.ones((len(points), 1))], 1)
        rays = rays @ np.linalg.inv(LINEMOD_K).T
        seen = np.array([box_hit(model, ray) for ray in rays])
        shift = np.nanmedian(points[:, 2] - seen) if np.isfinite(seen).any() else 0.0
        keypoints = transform(T_CAM_OBJ, model.keypoints) + np.array([0, 0, shift])
        keypoints = torch.from_numpy(keypoints).float()[None]
        covariance = torch.eye(3).expand(1, 9, 3, 3) * 1e-6
        return PointVotes(keypoints[:, None], torch.zeros(1, 1, 9), keypoints, covariance)


def box_hit(model, ray: np.ndarray) -> float:
    """Depth of the true box along one ray; NaN beside it."""
    K = np.array([[1, 0, -ray[0]], [0, 1, -ray[1]], [0, 0, 1.0]])
    depth = float(box_depth(model, T_CAM_OBJ, K, (1, 1))[0, 0])
    return depth or np.nan


@pytest.fixture(scope="module")
def depth(boxes) -> np.ndarray:
    """The brick before a table of constant depth."""
    seen = box_depth(boxes["brick"], T_CAM_OBJ, LINEMOD_K, (480, 640))
    return np.where(seen > 0, seen, 1.1).astype(np.float32)


@pytest.fixture
def estimator(networks: PoseNetworks) -> RgbdEstimator:
    networks = copy.deepcopy(networks)
    networks.points = FitsCenter(networks.objects)
    estimator = RgbdEstimator(networks)
    estimator.frontend = Votes2D(networks)
    return estimator


def view(depth: np.ndarray | None) -> View:
    return View(np.zeros((480, 640, 3), np.uint8), LINEMOD_K, np.eye(4), depth)


def test_points_come_from_the_object_in_the_camera_and_the_pose_from_them(estimator, depth, boxes):
    found = estimator.estimate([view(depth)], "brick")
    clouds = estimator.networks.points.clouds
    assert len(clouds) == 1
    half = np.abs(boxes["brick"].vertices).max(0)
    for points in clouds:
        assert len(points) > 100
        in_object = (points - T_CAM_OBJ[:3, 3]) @ T_CAM_OBJ[:3, :3]
        beside = np.abs(np.abs(in_object / half).max(1) - 1)
        # The nearest pixel may be half a pixel beside the ray.
        assert np.median(beside) < 0.02 and np.mean(beside < 0.1) > 0.95
    np.testing.assert_allclose(found.T_cam_obj, T_CAM_OBJ, atol=2e-3)
    truth = transform(T_CAM_OBJ, boxes["brick"].keypoints)
    np.testing.assert_allclose(found.keypoints, truth, atol=2e-3)
    assert found.T_cam_obj.dtype == np.float64 and found.keypoint_covariance.shape == (9, 3, 3)


def test_the_second_pass_crops_at_the_first_pose(estimator, depth, boxes):
    found = estimator.estimate([view(depth)], "brick")
    first, second = estimator.frontend.rois
    assert first is None
    np.testing.assert_allclose(second.center, project(T_CAM_OBJ[:3, 3], LINEMOD_K), atol=1.5)
    side = 1.4 * boxes["brick"].diameter * LINEMOD_K[0, 0] / T_CAM_OBJ[2, 3]
    assert second.side == pytest.approx(side, rel=0.02)
    assert len(found.rois) == 1 and found.rois[0].side > 1.05 * side  # the detector's own


def test_the_depth_map_determines_the_distance(estimator, depth):
    found = estimator.estimate([view(depth + 0.04)], "brick")
    shift = found.T_cam_obj[:3, 3] - T_CAM_OBJ[:3, 3]
    np.testing.assert_allclose(shift, [0, 0, 0.04], atol=6e-3)


def test_holes_are_tolerated_and_an_empty_depth_map_falls_back_to_single(estimator, depth):
    holes = depth.copy()
    holes[np.random.default_rng(0).random(depth.shape) < 0.7] = 0
    found = estimator.estimate([view(holes)], "brick")
    np.testing.assert_allclose(found.T_cam_obj, T_CAM_OBJ, atol=3e-3)
    blind = estimator.estimate([view(np.zeros_like(depth))], "brick")
    single = SingleViewEstimator(estimator.networks)
    single.frontend = estimator.frontend
    expected = single.estimate([view(depth)], "brick")
    np.testing.assert_allclose(blind.T_cam_obj, expected.T_cam_obj)
    assert blind.depth_use.points == 0 and blind.depth_use.distance is None
    assert found.depth_use.points > 100


def test_what_depth_shows_is_compared_with_the_size_in_the_image(estimator, depth):
    right = estimator.estimate([view(depth)], "brick").depth_use
    assert agrees(right) and enough(right)
    seen = T_CAM_OBJ[2, 3]
    assert right.expected == pytest.approx(seen, rel=0.01)
    assert right.distance == pytest.approx(seen, rel=0.1)
    check_depth_use(right, "brick", Path("d.png"), DepthMap(depth, 0.001))
    # 0.1 mm steps, as of our generator, read as millimeters.
    far = estimator.estimate([view(10 * depth)], "brick").depth_use
    assert far.distance == pytest.approx(10 * right.distance)
    with pytest.raises(InputError, match=r"d.png puts brick .* --depth-unit 0.0001 would fit"):
        check_depth_use(far, "brick", Path("d.png"), DepthMap(10 * depth, 0.001))


@pytest.mark.parametrize("unknown", [0.0, np.nan, np.inf, -np.inf])
def test_nan_and_infinity_mean_not_seen(unknown, estimator, depth):
    cut = depth.copy()
    cut[:, ::2] = unknown
    zero = estimator.estimate([view(np.where(np.isfinite(cut), cut, 0))], "brick")
    found = estimator.estimate([view(cut)], "brick")
    np.testing.assert_array_equal(found.T_cam_obj, zero.T_cam_obj)
    assert found.depth_use == zero.depth_use


def test_an_object_beyond_the_sensors_range_is_refused(estimator, depth):
    cut = np.where(depth < 1.0, np.nan, depth)  # only the table is left
    use = estimator.estimate([view(cut)], "brick").depth_use
    with pytest.raises(InputError, match=r"knows \d+ points of brick, \d % of its pixels"):
        check_depth_use(use, "brick", Path("d.png"), DepthMap(cut, 0.001))


def test_negative_depth_is_refused(depth):
    with pytest.raises(InputError, match=r"depth must not be negative .* got -1\.1"):
        view(-depth)


def test_a_file_of_negative_depth_is_refused_by_name(tmp_path):
    np.save(tmp_path / "d.npy", np.full((4, 4), -0.9))
    with pytest.raises(InputError, match=r"d\.npy must not be negative"):
        read_depth_map(tmp_path / "d.npy")


def test_further_views_are_ignored_and_answers_repeat(estimator, depth):
    alone = estimator.estimate([view(depth)], "brick")
    together = estimator.estimate([view(depth), view(None)], "brick")
    np.testing.assert_array_equal(alone.T_cam_obj, together.T_cam_obj)
    assert len(together.rois) == 1


def test_a_given_region_replaces_the_detector(estimator, depth):
    roi = Roi(project(T_CAM_OBJ[:3, 3], LINEMOD_K), 130.0, 1.0)
    found = estimator.estimate([view(depth)], "brick", rois=[roi])
    assert estimator.frontend.rois[0] is roi and found.rois == [roi]


def test_a_view_without_depth_is_refused(estimator):
    with pytest.raises(ValueError, match=r"rgbd needs the depth.*View\.depth"):
        estimator.estimate([view(None)], "brick")
