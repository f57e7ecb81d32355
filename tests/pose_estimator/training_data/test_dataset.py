"""Training samples: labels, images and cameras agree after every augmentation."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from two_view_pose.core.geometry import grid_matrix, project, transform
from two_view_pose.pose_estimator.networks.detector import DetectorConfig, decode
from two_view_pose.pose_estimator.networks.features import FeatureConfig, Features2D
from two_view_pose.pose_estimator.networks.voting import vote
from two_view_pose.pose_estimator.symmetry import canonical_pose
from two_view_pose.pose_estimator.training.loader import collate
from two_view_pose.pose_estimator.training_data.augmentation import AugmentationConfig
from two_view_pose.pose_estimator.training_data.crops import CropPack
from two_view_pose.pose_estimator.training_data.dataset import TrainingSet, sampling_weights
from two_view_pose.pose_estimator.training_data.target_sample import TargetSample, target_arrays

CONFIG = FeatureConfig()
PLAIN = AugmentationConfig(noise=0, blur=0, brightness=0, contrast=0, white_balance=0)
"""Jitters the crops without changing their colors."""


@pytest.fixture(scope="module")
def training(pack: CropPack, boxes) -> TrainingSet:
    return TrainingSet(pack, boxes, CONFIG)


def drawn_mask(sample: TargetSample, model) -> np.ndarray:
    """The silhouette of the sample's pose through the sample's camera, at the grid's size."""
    pixels = project(transform(sample.T_cam_obj, model.vertices), sample.K)
    hull = cv2.convexHull(pixels.astype(np.float32)).round().astype(np.int32)
    mask = cv2.fillConvexPoly(np.zeros((CONFIG.crop,) * 2, np.uint8), hull, 255)
    return cv2.resize(mask, (CONFIG.grid,) * 2, interpolation=cv2.INTER_AREA) / 255.0


@pytest.mark.parametrize("augmented", [False, True])
def test_the_pose_matches_mask_and_image(pack, boxes, augmented):
    training = TrainingSet(pack, boxes, CONFIG, replace(PLAIN, erase=0) if augmented else None)
    rng = np.random.default_rng(0)
    models = list(boxes.values())
    for _ in range(12):
        sample = training.draw_target(rng)
        expected = drawn_mask(sample, models[sample.object_index])
        assert np.abs(sample.mask - expected).mean() < 0.02
        # The object's color (red or blue) stands where the mask is.
        small = cv2.resize(sample.crop, (CONFIG.grid,) * 2, interpolation=cv2.INTER_AREA)
        ours = small[..., 0 if sample.object_index == 0 else 2].astype(int) > 170
        other = small[..., 2 if sample.object_index == 0 else 0].astype(int) < 100
        assert ((ours & other) == (sample.mask > 0.5)).mean() > 0.97


def test_directions_vote_for_the_keypoints_of_the_pose(training, boxes):
    rng = np.random.default_rng(1)
    samples = [training.draw_target(rng) for _ in range(6)]
    tensors = collate([target_arrays(sample) for sample in samples])
    mean, _, score = vote(
        Features2D(10 * (2 * tensors["mask"] - 1), tensors["directions"], *torch.zeros(2))
    )
    models = list(boxes.values())
    for sample, found in zip(samples, mean.numpy(), strict=True):
        model = models[sample.object_index]
        pixels = project(transform(sample.T_cam_obj, model.keypoints), sample.K)
        expected = pixels @ grid_matrix(4)[:2, :2].T + grid_matrix(4)[:2, 2]
        assert np.abs(found - expected).max() < 0.1
    assert (score > 0.95).all()


def test_without_augmentation_the_crop_equals_the_estimators(pack, boxes, dataset):
    from two_view_pose.core.geometry import crop_matrix
    from two_view_pose.core.image_crop import warp_crop
    from two_view_pose.pose_estimator.bop.dataset import read_dataset, read_rgb

    training = TrainingSet(pack, boxes, CONFIG, None)
    image = read_dataset(dataset, "train_pbr").scene(0)[0]
    T = image.annotations[0].T_cam_obj
    side = CONFIG.roi_scale * boxes["brick"].diameter * image.K[0, 0] / T[2, 3]
    to_crop = crop_matrix(project(T[:3, 3], image.K), side, CONFIG.crop)
    expected = warp_crop(read_rgb(image), to_crop, CONFIG.crop)
    sample = training.target(0, np.random.default_rng(0))
    assert np.allclose(sample.K, to_crop @ image.K, atol=1e-6)
    assert np.abs(sample.crop.astype(int) - expected).mean() < 3


def test_pairs_show_one_object_from_two_cameras(training, boxes, pack):
    rng = np.random.default_rng(2)
    models = list(boxes.values())
    seen = set()
    for _ in range(10):
        first, second, T_second_ref = training.draw_pair(rng)
        assert first.object_index == second.object_index
        seen.add(first.object_index)
        model = models[first.object_index]
        # The first view's pose, moved by T_second_ref, is a pose of the second (or equivalent).
        moved = T_second_ref @ first.T_cam_obj
        assert any(np.allclose(moved @ S, second.T_cam_obj, atol=1e-6) for S in model.symmetries)
        assert not np.allclose(T_second_ref, np.eye(4), atol=1e-3)
        between = [b @ np.linalg.inv(a) for a in pack.T_cam_world for b in pack.T_cam_world]
        assert any(np.allclose(T_second_ref, T, atol=1e-5) for T in between)
    assert seen == {0, 1}


def test_symmetric_objects_get_the_canonical_pose(training, pack, boxes):
    model = boxes["crate"]
    for target in training.by_object[1]:
        sample = training.target(int(target), np.random.default_rng(0))
        assert np.allclose(
            sample.T_cam_obj,
            canonical_pose(sample.T_cam_obj @ model.symmetries[1], model.symmetries),
        )


def test_held_out_scenes_are_not_in_the_training_set(pack, boxes):
    train, held_out = (
        TrainingSet(pack, boxes, CONFIG, validation=0.3, held_out=later) for later in (False, True)
    )
    scenes = [set(pack.scene_id[s.frames].tolist()) for s in (train, held_out)]
    assert scenes == [{0, 1}, {2}]
    assert not set(train.targets.tolist()) & set(held_out.targets.tolist())
    assert len(train.targets) + len(held_out.targets) == len(pack.object_index)


def test_detector_targets_of_a_frame_are_on_the_objects(training, boxes):
    config = DetectorConfig()
    rng = np.random.default_rng(0)
    for _ in range(5):
        image, heat, regression, _weight = training.draw_frame(rng, config)
        assert image.shape == (240, 320, 3)
        for index in range(2):
            roi = decode(heat[index] * 20 - 10, regression[index], np.eye(3), config)
            u, v = roi.center.round().astype(int)
            if roi.score < 0.9 or not (2 < u < 317 and 2 < v < 237):
                continue
            red, _, blue = cv2.blur(image, (3, 3))[v, u].astype(int)
            assert (red > blue + 40) if index == 0 else (blue > red + 40)
            colors = image.astype(int)
            ours = colors[..., 2 * index] > 60 + colors[..., 2 - 2 * index]
            # The border mirrors what it cuts: look at the region alone.
            reach = int(roi.side / 2)
            near = ours[max(v - reach, 0) : v + reach, max(u - reach, 0) : u + reach]
            assert 0.3 < np.sqrt(near.sum()) / roi.side < 0.9


def test_an_erased_box_is_removed_from_the_mask(pack, boxes):
    training = TrainingSet(pack, boxes, CONFIG, replace(PLAIN, erase=1))
    rng = np.random.default_rng(0)
    missing = []
    for _ in range(12):
        sample = training.draw_target(rng)
        color = (220, 40, 40) if sample.object_index == 0 else (40, 60, 220)
        near = (np.abs(sample.crop.astype(int) - color).max(-1) < 25).astype(np.uint8) * 255
        shown = cv2.resize(near, sample.mask.shape, interpolation=cv2.INTER_AREA) > 127
        assert shown[sample.mask > 0.95].mean() > 0.99
        whole = drawn_mask(sample, list(boxes.values())[sample.object_index])
        missing.append(whole.sum() - sample.mask.sum())
    assert max(missing) > 20 and min(missing) > -5


def test_too_few_scenes_to_validate_is_an_error(pack, boxes):
    alone = replace(pack, scene_id=np.zeros_like(pack.scene_id))
    for later in (False, True):
        with pytest.raises(ValueError, match="has 1 scene, and 1 of them would be kept"):
            TrainingSet(alone, boxes, CONFIG, held_out=later)
    with pytest.raises(ValueError, match=r"has 3 scenes, and 3 of them .* lower --validation"):
        TrainingSet(pack, boxes, CONFIG, validation=0.9)


def test_pairs_need_two_images_of_a_scene(pack, boxes):
    apart = replace(pack, scene_id=np.arange(len(pack.scene_id)))
    with pytest.raises(ValueError, match="generate --views 2"):
        TrainingSet(apart, boxes, CONFIG).draw_pair(np.random.default_rng(0))


def test_sampling_weights_of_tilted_and_occluded_targets(pack):
    assert np.allclose(sampling_weights(pack), 1)  # all stand upright, in full view
    lying = pack.T_cam_obj.copy()
    lying[0, :3, :3] = lying[0, :3, :3] @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    visibility = pack.visibility.copy()
    visibility[1] = 0.2
    weights = sampling_weights(replace(pack, T_cam_obj=lying, visibility=visibility))
    assert np.allclose(weights[:3], (0.2, 0.4, 1))
    no_world = replace(pack, T_cam_obj=lying, T_cam_world=np.tile(np.eye(4), (9, 1, 1)))
    assert np.allclose(sampling_weights(no_world), 1)
