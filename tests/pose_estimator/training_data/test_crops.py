"""Crops keep positions at subpixel accuracy; packs hold every target."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from two_view_pose.core.errors import InputError
from two_view_pose.core.geometry import LINEMOD_K, crop_matrix, project
from two_view_pose.core.image_crop import warp_crop
from two_view_pose.pose_estimator.bop.dataset import read_dataset
from two_view_pose.pose_estimator.training_data.crop_packing import pack_dataset
from two_view_pose.pose_estimator.training_data.crops import (
    STORED_SCALE,
    STORED_SIDE,
    CropPack,
    open_pack,
)


def dot(position: tuple[float, float], sigma: float) -> np.ndarray:
    """An image (480, 640, 3) of a bright Gaussian dot."""
    columns, rows = np.meshgrid(np.arange(640), np.arange(480))
    distance = (columns - position[0]) ** 2 + (rows - position[1]) ** 2
    gray = np.round(255 * np.exp(-distance / (2 * sigma**2))).astype(np.uint8)
    return np.repeat(gray[..., None], 3, 2)


def centroid(crop: np.ndarray) -> np.ndarray:
    weight = crop[..., 0].astype(float)
    rows, columns = np.mgrid[: crop.shape[0], : crop.shape[1]]
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()


@pytest.mark.parametrize("side", [60.0, 128.0, 183.0, 250.0, 330.0, 411.0])
def test_warp_crop_keeps_positions(side):
    position = (301.3, 222.6)
    image = dot(position, side / 20)
    affine = crop_matrix(np.array([310.7, 228.2]), side, 128)
    expected = (affine @ [*position, 1])[:2]
    assert np.abs(centroid(warp_crop(image, affine, 128)) - expected).max() < 0.05


def test_a_rotated_crop_keeps_positions():
    position = (301.3, 222.6)
    turn = cv2.getRotationMatrix2D((63.5, 63.5), 20, 1.0)
    affine = np.vstack([turn, [0, 0, 1]]) @ crop_matrix(np.array([310.7, 228.2]), 300.0, 128)
    crop = warp_crop(dot(position, 15), affine, 128)
    assert np.abs(centroid(crop) - (affine @ [*position, 1])[:2]).max() < 0.05


@pytest.mark.parametrize("side", [60.0, 250.0, 400.0])
def test_warp_crop_keeps_a_ramp(side):
    ramp = np.repeat(np.arange(640, dtype=np.float64)[None] * 0.39, 480, 0).round()
    affine = crop_matrix(np.array([320.0, 240.0]), side, 128)
    crop = warp_crop(ramp.astype(np.uint8), affine, 128).astype(float)
    columns = (np.linalg.inv(affine) @ [np.arange(128), np.zeros(128), np.ones(128)])[0]
    assert np.abs(crop[64, 2:-2] - 0.39 * columns[2:-2]).max() < 1.2
    assert np.abs(crop[64] - 0.39 * columns).mean() < 0.4


def test_warp_crop_averages_when_shrinking():
    board = np.indices((480, 640)).sum(0) % 2 * 255
    crop = warp_crop(board.astype(np.uint8), crop_matrix(np.array([320, 240]), 400.0, 128), 128)
    assert np.abs(crop[4:-4, 4:-4].astype(int) - 127).max() < 60


@pytest.mark.parametrize("center", [(-500.0, 240.0), (5000.0, 240.0), (320.0, -900.0)])
@pytest.mark.parametrize("side", [60.0, 400.0])
def test_outside_of_the_image_is_gray(center, side):
    affine = crop_matrix(np.array(center), side, 64)
    image = np.full((480, 640, 3), 255, np.uint8)
    assert (warp_crop(image, affine, 64) == 127).all()
    assert (warp_crop(image[..., 0], affine, 64) == 0).all()


def test_a_pack_holds_every_target_centered(pack: CropPack, boxes, dataset):
    assert len(pack.object_index) == 3 * 3 * 2 and len(pack.scene_id) == 9
    assert pack.object_names == ("brick", "crate")
    models = list(boxes.values())
    for target in range(0, len(pack.object_index), 5):
        model = models[pack.object_index[target]]
        K = pack.to_stored[target] @ pack.K[pack.frame_index[target]]
        T = pack.T_cam_obj[target]
        middle = (STORED_SIDE - 1) / 2
        assert np.allclose(project(T[:3, 3], K), middle, atol=1e-6)
        assert pack.crop(target).shape == (STORED_SIDE, STORED_SIDE, 3)
        # The stored mask is the silhouette, drawn again at the stored scale.
        corners = project(model.vertices @ T[:3, :3].T + T[:3, 3], K).astype(np.float32)
        hull = cv2.convexHull(corners).round().astype(np.int32)
        again = cv2.fillConvexPoly(np.zeros((STORED_SIDE,) * 2, np.uint8), hull, 1) > 0
        mask = pack.mask(target) > 127
        assert (mask & again).sum() / (mask | again).sum() > 0.93
        assert K[0, 0] * model.diameter / T[2, 3] == pytest.approx(STORED_SIDE / STORED_SCALE)
    frame = pack.frame(0)
    assert frame.shape == (240, 320, 3)
    to_small = np.linalg.inv(pack.frame_to_image[0])
    u, v = (to_small @ pack.K[0] @ pack.T_cam_obj[0][:3, 3] / pack.T_cam_obj[0][2, 3])[:2]
    assert np.abs(frame[round(v), round(u)].astype(int) - (220, 40, 40)).max() < 12


def packed_at(dataset) -> int:
    return (dataset / "packed_train_pbr" / "crops.bin").stat().st_mtime_ns


def test_a_pack_is_reused_or_packed_again_for_other_objects(dataset, boxes, tmp_path):
    copy = shutil.copytree(dataset, tmp_path / "copy", ignore=shutil.ignore_patterns("packed_*"))
    first = pack_dataset(copy, boxes)
    made = packed_at(copy)
    assert np.array_equal(pack_dataset(copy, boxes).crops, first.crops) and packed_at(copy) == made
    larger = replace(boxes["brick"], diameter=boxes["brick"].diameter * 1.01)
    moved = replace(boxes["brick"], keypoints=boxes["brick"].keypoints + 1e-4)
    for others in ({"brick": larger}, {"brick": moved}, {}):
        pack_dataset(copy, {**others, "crate": boxes["crate"]})
        assert packed_at(copy) > made
        made = packed_at(copy)


def test_a_dataset_with_other_scenes_is_packed_again(dataset, boxes, tmp_path):
    copy = shutil.copytree(dataset, tmp_path / "copy", ignore=shutil.ignore_patterns("packed_*"))
    scenes = copy / "train_pbr"
    assert set(pack_dataset(copy, boxes).scene_id) == {0, 1, 2}
    (scenes / "000001").rename(scenes / "000007")
    assert set(pack_dataset(copy, boxes).scene_id) == {0, 2, 7}
    truth = scenes / "000007" / "scene_gt.json"
    poses = json.loads(truth.read_text())
    poses["0"][0]["cam_t_m2c"] = [1.5, 2.5, 1000.125]
    truth.write_text(json.dumps(poses))
    changed = pack_dataset(copy, boxes)
    image = read_dataset(copy, "train_pbr").scene(7)[0]
    found = [np.allclose(T, image.annotations[0].T_cam_obj) for T in changed.T_cam_obj]
    assert sum(found) == 1


@pytest.mark.slow
def test_several_processes_pack_like_one(dataset, boxes, tmp_path):
    scenes = tmp_path / "many" / "train_pbr"
    for number in range(9):
        shutil.copytree(dataset / "train_pbr" / f"{number % 3:06d}", scenes / f"{number:06d}")
    many, few = pack_dataset(tmp_path / "many", boxes), pack_dataset(dataset, boxes)
    assert np.array_equal(many.scene_id, np.arange(9).repeat(3))
    targets, length = len(few.object_index), len(few.crops)
    assert np.array_equal(many.T_cam_obj, np.tile(few.T_cam_obj, (3, 1, 1)))
    assert np.array_equal(many.spans[targets : 2 * targets], few.spans + length)
    assert np.array_equal(many.crops, np.tile(few.crops, 3))


def test_a_missing_split_is_an_error(dataset, boxes):
    with pytest.raises(ValueError, match="no split 'test'"):
        pack_dataset(dataset, boxes, split="test")


def test_the_camera_of_the_dataset_is_linemods(pack: CropPack):
    assert np.allclose(pack.K, LINEMOD_K)


@pytest.mark.parametrize("damage", ["truncated", "spans", "K"])
def test_a_damaged_pack_is_refused_by_name(
    pack: CropPack, dataset: Path, tmp_path: Path, damage: str
) -> None:
    folder = shutil.copytree(dataset / "packed_train_pbr", tmp_path / "pack")
    path = folder / "index.npz"
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:500])
    else:
        with np.load(path) as file:
            arrays = dict(file)
        arrays[damage] = arrays[damage] * 1000 if damage == "spans" else arrays[damage][:, :2]
        np.savez(path, **arrays)
    with pytest.raises(InputError, match=f"{folder} is damaged.*delete it"):
        open_pack(folder, pack.object_names)
