"""Augmentations change what their fields say, and draw from the given generator only."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from two_view_pose.pose_estimator.training_data.augmentation import (
    AugmentationConfig,
    augment_colors,
    erase_box,
    paint_spots,
    recolor_side,
)

PLAIN = AugmentationConfig(noise=0, blur=0, brightness=0, contrast=0, white_balance=0)
"""Leaves the colors as they are."""


@pytest.mark.parametrize("config", [AugmentationConfig(), AugmentationConfig.strong()])
def test_augment_colors_depends_on_the_generator_only(config):
    image = np.random.default_rng(0).integers(0, 256, (64, 48, 3), dtype=np.uint8)
    before, results = image.copy(), []
    for seed in range(30):
        first, again = (
            augment_colors(image, config, np.random.default_rng(seed)) for _ in range(2)
        )
        assert np.array_equal(first, again)
        assert first.shape == image.shape and first.dtype == np.uint8
        results.append(first)
    assert not np.array_equal(results[0], results[1]) and np.array_equal(image, before)


@pytest.mark.parametrize(
    ("change", "statistic"),
    [
        ({"saturation": 1.0}, lambda p: np.ptp(p.astype(int), axis=-1).mean()),
        ({"shading": 1.0}, lambda p: np.abs(p[:8].mean() - p[-8:].mean())),
        ({"motion_blur": 1.0}, lambda p: np.abs(np.diff(p[..., 0].astype(int), axis=1)).mean()),
        ({"sharpen": 1.0}, lambda p: np.abs(np.diff(p[..., 0].astype(int), axis=1)).mean()),
        ({"low_resolution": 1.0}, lambda p: np.abs(np.diff(p[..., 0].astype(int), axis=1)).mean()),
    ],
)
def test_color_augmentations_change_their_statistic(change, statistic):
    image = cv2.GaussianBlur(
        np.random.default_rng(0).integers(60, 196, (64, 64, 3), dtype=np.uint8), (0, 0), 1.0
    )
    plain = statistic(image)
    found = [
        statistic(augment_colors(image, replace(PLAIN, **change), np.random.default_rng(s)))
        for s in range(12)
    ]
    if "saturation" in change:
        assert min(found) < 0.8 * plain and max(found) > 1.2 * plain
    elif "motion_blur" in change or "low_resolution" in change:
        assert max(found) < plain
    else:
        assert min(found) > plain or np.median(found) > 1.1 * plain


def test_spots_stay_on_the_target():
    image = np.full((64, 64, 3), 120, np.uint8)
    mask = cv2.circle(np.zeros((64, 64), np.uint8), (30, 34), 16, 255, -1)
    before, changed = image.copy(), 0
    for seed in range(20):
        spotted = paint_spots(replace(PLAIN, spots=1.0), np.random.default_rng(seed), image, mask)
        assert (spotted[mask == 0] == 120).all() and spotted.dtype == np.uint8
        changed += (np.abs(spotted.astype(int) - 120) > 20).any()
    assert changed > 12 and np.array_equal(image, before)
    for config, seen in ((PLAIN, mask), (replace(PLAIN, spots=1.0), np.zeros_like(mask))):
        assert paint_spots(config, np.random.default_rng(0), image, seen) is image


def test_a_recolored_side_is_visible():
    image = np.full((64, 64, 3), 120, np.uint8)
    mask = np.zeros((64, 64), np.uint8)
    mask[10:55, 12:52] = 255
    before, sides, hidden = image.copy(), set(), 0
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(-1, 3) * 1.0
    pixels = 32 + 20 * (corners[:, :2] + 0.2 * corners[:, 2:])  # seen along z, a little from below
    towards = np.array([-0.3, -0.4, -1.0])
    config = replace(PLAIN, recolored_side=1.0)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        painted = recolor_side(config, rng, image, mask, corners, pixels, towards)
        changed = np.abs(painted.astype(int) - 120).max(-1) > 10
        assert not changed[mask == 0].any()
        if changed.any():
            rows, columns = np.nonzero(changed)
            sides.add((columns.mean() < 25, rows.mean() < 25))
            hidden += columns.mean() > 38 or rows.mean() > 38  # its edge may still be seen
    assert hidden < 5
    assert {(True, False), (False, True), (False, False)} <= sides and np.array_equal(image, before)
    rng = np.random.default_rng(0)
    none = np.zeros((0, 3))
    assert recolor_side(PLAIN, rng, image, mask, corners, pixels, towards) is image
    assert recolor_side(config, rng, image, mask, none, none[:, :2], towards) is image


def test_erase_box_clears_mask_and_depth():
    rng = np.random.default_rng(0)
    boxes = 0
    for _ in range(60):
        image = np.full((40, 50, 3), 9, np.uint8)
        mask, depth = np.full((40, 50), 255, np.uint8), np.ones((40, 50), np.float32)
        erase_box(AugmentationConfig(erase=0.5), rng, image, mask, depth)
        hidden = (image != 9).any(-1)
        assert np.array_equal(hidden, mask == 0) and np.array_equal(hidden, depth == 0)
        boxes += hidden.any()
        rows, columns = np.flatnonzero(hidden.any(1)), np.flatnonzero(hidden.any(0))
        assert hidden.sum() == len(rows) * len(columns)
    assert 15 < boxes < 45
