"""The detector: targets, decoding and letterboxing agree."""

import numpy as np
import pytest
import torch
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.networks.detector import (
    DetectorConfig,
    decode,
    decode_peaks,
    detection_targets,
    detector_input,
)
from two_view_pose.pose_estimator.training.losses import box_loss, heat_map_loss

CONFIG = DetectorConfig()


def targets(*centers: tuple[float, float], side: float = 60.0):
    count = len(centers)
    return detection_targets(np.array(centers), np.full(count, side), np.ones(count, bool), CONFIG)


def logits_of(heat: np.ndarray) -> np.ndarray:
    return np.log(np.clip(heat, 1e-4, 1 - 1e-4) / (1 - np.clip(heat, 1e-4, 1 - 1e-4)))


@pytest.mark.parametrize("center", [(160.3, 120.9), (3.5, 3.5), (316.0, 236.2), (41.0, 77.7)])
@pytest.mark.parametrize("side", [12.0, 60.0, 220.0])
def test_targets_round_trip_through_decode(center, side):
    heat, regression, weight = targets(center, side=side)
    roi = decode(logits_of(heat[0]), regression[0], np.eye(3), CONFIG)
    assert np.allclose(roi.center, center, atol=1e-4)
    assert roi.side == pytest.approx(side, rel=1e-5)
    assert roi.score > 0.99
    assert heat[0].max() == 1.0 and weight[0].sum() >= 1


def test_every_weighted_cell_points_at_the_center():
    _, regression, weight = targets((160.3, 120.9), side=120.0)
    assert weight[0].sum() > 4
    for row, column in np.argwhere(weight[0]):
        logits = np.full((30, 40), -5.0)
        logits[row, column] = 3.0
        roi = decode(logits, regression[0], np.eye(3), CONFIG)
        assert np.allclose(roi.center, (160.3, 120.9), atol=1e-3)


def test_absent_or_outside_objects_have_no_peak():
    heat, _, weight = detection_targets(
        np.array([(100.0, 100.0), (-200.0, 100.0)]), np.full(2, 60.0),
        np.array([False, True]), CONFIG,
    )  # fmt: skip
    assert heat[0].max() == 0 and weight.sum() == 0
    assert heat[1].max() < 0.01


@pytest.mark.parametrize("size", [(480, 640), (720, 1280), (1024, 768), (240, 320), (100, 150)])
def test_letterbox_round_trip(size):
    height, width = size
    position = np.array([0.72 * width, 0.31 * height])
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    sigma = 0.02 * width
    distance = (columns - position[0]) ** 2 + (rows - position[1]) ** 2
    gray = 255 * np.exp(-distance / (2 * sigma**2))
    image = np.repeat(gray[..., None], 3, 2).astype(np.uint8)
    small, to_image = detector_input(image, CONFIG)
    assert small.shape == (240, 320, 3)
    weight = np.where(small[..., 0] == 127, 0, small[..., 0]).astype(float)
    inside = np.linalg.inv(to_image) @ [width - 1, height - 1, 1]
    weight[int(inside[1]) + 1 :] = weight[:, int(inside[0]) + 1 :] = 0
    rows, columns = np.mgrid[:240, :320]
    found = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
    assert np.abs((to_image @ [*found, 1])[:2] - position).max() < 0.15 * to_image[0, 0]
    # The whole detection: a peak at that input pixel becomes a region in full-frame pixels.
    heat, regression, _ = targets(tuple(np.linalg.inv(to_image) @ [*position, 1])[:2])
    roi = decode(logits_of(heat[0]), regression[0], to_image, CONFIG)
    assert np.allclose(roi.center, position, atol=1e-3 * width)
    assert roi.side == pytest.approx(60 * to_image[0, 0], rel=1e-5)


def test_linemod_frames_are_halved_exactly():
    image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    small, to_image = detector_input(image, CONFIG)
    assert np.allclose(to_image @ [10, 20, 1], [20.5, 40.5, 1])
    blocks = image.reshape(240, 2, 320, 2, 3).astype(float).mean((1, 3))
    assert np.abs(small - blocks).max() <= 0.51


def test_extreme_aspect_ratio():
    small, to_image = detector_input(np.zeros((3, 5000, 3), np.uint8), CONFIG)
    assert small.shape == (240, 320, 3) and np.isfinite(to_image).all()


def test_decode_peaks_sorts_by_score():
    left, right = (60.0, 120.0), (260.0, 120.0)
    heat, regression, _ = targets(left, right)
    use_left = heat[0] > heat[1]
    logits = np.maximum(logits_of(0.6 * heat[0]), logits_of(0.9 * heat[1]))
    both = np.where(use_left, regression[0], regression[1])
    to_image = np.diag([2.0, 2.0, 1.0])
    to_image[:2, 2] = 0.5
    found = decode_peaks(logits, both, to_image, CONFIG)
    assert len(found) == 2
    for roi, center, score in zip(found, (right, left), (0.9, 0.6), strict=True):
        assert np.allclose(roi.center, np.array(center) * 2 + 0.5, atol=1e-3)
        assert roi.score == pytest.approx(score, abs=0.05)
    alone = decode(logits, both, to_image, CONFIG)
    assert np.array_equal(alone.center, found[0].center) and alone.side == found[0].side
    faint = np.maximum(logits_of(0.002 * heat[0]), logits_of(0.9 * heat[1]))
    assert len(decode_peaks(faint, both, to_image, CONFIG)) == 1
    # The best cell is always returned.
    nothing = decode_peaks(np.full_like(logits, -9.0), both, to_image, CONFIG)
    assert len(nothing) == 1


def test_output_shapes_match_the_targets(networks: PoseNetworks):
    with torch.no_grad():
        logits, regression = networks.detector(torch.zeros(1, 3, 240, 320))
    heat, target, _ = targets((60.0, 120.0), (80.0, 90.0))
    assert logits.shape[1:] == heat.shape and regression.shape[1:] == target.shape


def test_losses_are_minimal_at_the_targets():
    heat, regression, weight = (torch.from_numpy(t)[None] for t in targets((160.3, 120.9)))
    right = torch.where(heat >= 1, 9.0, -9.0)
    shifted = torch.roll(right, 3, -1)
    assert float(heat_map_loss(right, heat)) < 0.02 < float(heat_map_loss(shifted, heat))
    assert float(box_loss(regression, regression, weight)) == 0
    assert float(box_loss(regression + 0.5, regression, weight)) == pytest.approx(0.5)
