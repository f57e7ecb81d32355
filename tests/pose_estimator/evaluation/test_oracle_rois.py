"""Ground-truth regions of interest, and their noise."""

from pathlib import Path

import numpy as np
import pytest
from helpers.study_cases import Oracle
from two_view_pose.core.geometry import LINEMOD_K, View, make_transform, project, transform
from two_view_pose.pose_estimator.bop.dataset import BopDataset, read_dataset, read_pairs
from two_view_pose.pose_estimator.evaluation.evaluate_pairs import evaluate_pairs
from two_view_pose.pose_estimator.evaluation.oracle_rois import GroundTruthRois


@pytest.fixture(scope="module")
def opened(dataset: Path) -> BopDataset:
    return read_dataset(dataset, "train_pbr")


def test_regions_of_interest_can_be_the_true_ones(opened, dataset, boxes):
    oracle = Oracle(opened, boxes)
    pairs = read_pairs(dataset)
    exact = GroundTruthRois(1.4)
    evaluate_pairs(oracle, opened, pairs, boxes, ground_truth_rois=exact, progress=False)
    for pair, (views, _, rois) in zip(pairs, oracle.requests, strict=True):
        scene = opened.scene(pair.scene_id)
        assert len(rois) == len(views) == 2
        for image_id, roi in zip((pair.ref_image_id, pair.second_image_id), rois, strict=True):
            image = scene[image_id]
            model = next(m for m in boxes.values() if m.obj_id == pair.target_obj_id)
            T = image.annotation(model.obj_id).T_cam_obj
            corners = project(transform(T, model.vertices), image.K)
            np.testing.assert_allclose(roi.center, project(T[:3, 3], image.K), atol=1e-6)
            assert np.ptp(corners, axis=0).max() < roi.side < 2.5 * np.ptp(corners, axis=0).max()


def test_noise_is_in_depth_and_sideways():
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 1.0]))
    views = [View(np.zeros((480, 640, 3), np.uint8), LINEMOD_K, np.eye(4))] * 2
    noisy = GroundTruthRois(1.4, depth_noise=0.04, side_noise=0.012)
    drawn = [noisy.make([T, T], views, 0.1, number) for number in range(400)]
    depth = np.array([1.4 * 0.1 * LINEMOD_K[0, 0] / roi.side for rois in drawn for roi in rois])
    assert depth.mean() == pytest.approx(1.0, abs=0.01)
    assert depth.std() == pytest.approx(0.04, abs=0.004)
    pixels = np.array([roi.center for rois in drawn for roi in rois]) - LINEMOD_K[:2, 2]
    spread = (pixels / LINEMOD_K[[0, 1], [0, 1]] * depth[:, None]).std(axis=0)
    np.testing.assert_allclose(spread, 0.012, atol=0.0015)
    # Each image has noise of its own, and the same in every run.
    assert drawn[0][0].side != drawn[0][1].side
    assert noisy.make([T, T], views, 0.1, 7)[1].side == drawn[7][1].side
    assert np.array_equal(T, make_transform(np.eye(3), np.array([0.0, 0.0, 1.0])))
