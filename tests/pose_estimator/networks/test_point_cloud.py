"""Sampled points lie on the depth map, in a frame that rotates with the crop."""

import numpy as np
import pytest
import torch
from helpers.boxes import box_depth
from scipy.spatial.transform import Rotation
from two_view_pose.core.geometry import LINEMOD_K, crop_matrix, grid_matrix, make_transform, project
from two_view_pose.pose_estimator.networks.point_cloud import crop_frame, sample_points

SIDE = 128
T_CAM_OBJ = make_transform(
    Rotation.from_euler("xyz", [0.4, 0.7, 0.2]).as_matrix(), np.array([0.12, -0.08, 0.9])
)


def rotated_crop(radians: float, scale: float = 1.3) -> np.ndarray:
    """Camera of a crop around the object, rotated in the image."""
    center = project(T_CAM_OBJ[:3, 3], LINEMOD_K) + np.array([3, -5])
    A = crop_matrix(center, SIDE / scale, SIDE)
    rotation = np.eye(3)
    rotation[:2, :2] = Rotation.from_euler("z", radians).as_matrix()[:2, :2]
    middle = np.array([(SIDE - 1) / 2] * 2)
    rotation[:2, 2] = middle - rotation[:2, :2] @ middle
    return rotation @ A @ LINEMOD_K


def sample(depth, mask, K, diameter=0.15, count=200, seed=0):
    return sample_points(
        torch.from_numpy(depth)[None].float(),
        torch.from_numpy(mask)[None].float(),
        torch.from_numpy(K)[None].float(),
        torch.tensor([diameter]),
        count,
        torch.Generator().manual_seed(seed),
    )


@pytest.mark.parametrize("radians", [0.0, 0.6])
def test_points_lie_on_the_object_at_their_pixels(boxes, radians):
    K, brick = rotated_crop(radians), boxes["brick"]
    depth = box_depth(brick, T_CAM_OBJ, K, (SIDE, SIDE))
    cloud = sample(depth, np.ones((32, 32)), K)
    assert cloud.valid.all()
    R = cloud.R_crop_cam[0].double().numpy()
    in_camera = cloud.xyz[0].double().numpy() @ R
    in_object = (in_camera - T_CAM_OBJ[:3, 3]) @ T_CAM_OBJ[:3, :3]
    half = np.abs(brick.vertices).max(0)
    assert np.abs(np.abs(in_object) / half).max(1) == pytest.approx(1, abs=1e-3)
    pixels = project(in_camera, grid_matrix(4) @ K)
    np.testing.assert_allclose(cloud.pixels[0].numpy(), pixels, atol=1e-3)
    # Points that half of all are beyond, on each axis.
    np.testing.assert_allclose(cloud.center[0], np.median(cloud.xyz[0], 0), atol=1e-3)


def test_points_are_the_same_under_autocast(boxes):
    K = rotated_crop(0.3)
    depth = box_depth(boxes["brick"], T_CAM_OBJ, K, (SIDE, SIDE))
    expected = sample(depth, np.ones((32, 32)), K)
    with torch.autocast("cpu", torch.bfloat16):
        found = sample(depth, np.ones((32, 32)), K)
    for part, other in zip(found, expected, strict=True):
        assert torch.equal(part, other)


def test_crop_frame_follows_the_crops_center_and_rotation():
    straight, rotated = (
        crop_frame(torch.from_numpy(rotated_crop(a))[None], SIDE)[0].numpy() for a in (0.0, 0.5)
    )
    for R, K in ((straight, rotated_crop(0.0)), (rotated, rotated_crop(0.5))):
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1)
        backward = np.linalg.inv(K)
        middle = R @ backward @ [(SIDE - 1) / 2, (SIDE - 1) / 2, 1]
        np.testing.assert_allclose(middle[:2], 0, atol=1e-9)
        right = R @ backward @ [SIDE, (SIDE - 1) / 2, 1]
        assert right[0] > 0 and right[1] == pytest.approx(0, abs=1e-4)
    rotation = Rotation.from_matrix(rotated @ straight.T).as_rotvec()
    np.testing.assert_allclose(rotation, [0, 0, 0.5], atol=5e-3)


def test_samples_have_depth_and_lie_in_the_mask():
    depth = np.full((SIDE, SIDE), 1.0)
    depth[:, 64:] = 0
    mask = np.zeros((32, 32))
    mask[8:24] = 1
    cloud = sample(depth, mask, rotated_crop(0.0), diameter=1.0)
    columns, rows = (4 * cloud.pixels[0].numpy() + 1.5).T
    assert cloud.valid.all()
    assert columns.max() < 64 and rows.min() >= 31 and rows.max() <= 97
    assert len(set(zip(columns.round(), rows.round(), strict=True))) == 200  # none twice
    again, other = (sample(depth, mask, rotated_crop(0.0), 1.0, seed=s) for s in (0, 1))
    assert torch.equal(again.xyz, cloud.xyz) and not torch.equal(other.xyz, cloud.xyz)


def test_distant_points_are_rejected():
    depth = np.full((SIDE, SIDE), 1.0)
    depth[:40] = 1.4  # a wall behind, within the mask
    cloud = sample(depth, np.ones((32, 32)), rotated_crop(0.0), diameter=0.2, count=400)
    share = cloud.valid.float().mean().item()
    assert share == pytest.approx(88 / 128, abs=0.08)
    kept = cloud.xyz[0][cloud.valid[0]]
    assert (kept @ cloud.R_crop_cam[0])[:, 2].max() < 1.01


def test_few_or_no_pixels():
    depth = np.zeros((SIDE, SIDE))
    depth[60, 50:57] = 1.0
    cloud = sample(depth, np.ones((32, 32)), rotated_crop(0.0), count=64)
    assert cloud.valid.sum() == 7
    cloud = sample(np.zeros((SIDE, SIDE)), np.ones((32, 32)), rotated_crop(0.0), count=64)
    assert not cloud.valid.any()
    assert all(torch.isfinite(part.float()).all() for part in cloud)
