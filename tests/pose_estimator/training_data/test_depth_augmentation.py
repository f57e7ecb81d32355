"""Depth noise: its strength, and that unknown depth stays unknown."""

import numpy as np
import pytest
from two_view_pose.pose_estimator.training_data.depth_augmentation import (
    DepthAugmentationConfig,
    augment_depth,
)

NOTHING = DepthAugmentationConfig(noise=0.0, steps=0.0, window=0.0, edges=0, holes=0.0, lost=0.0)


def only(**parts: float) -> DepthAugmentationConfig:
    """No change but for the given parts."""
    return DepthAugmentationConfig(**{**vars(NOTHING), **parts})


def wall_and_box() -> np.ndarray:
    depth = np.full((128, 128), 1.1, np.float32)
    depth[40:90, 30:80] = 0.9
    depth[:, 120:] = 0
    return depth


def test_zero_strength_changes_nothing():
    depth = wall_and_box()
    out = augment_depth(depth, NOTHING, np.random.default_rng(0))
    np.testing.assert_allclose(out, depth, atol=1e-6)
    assert out is not depth


def test_depth_noise_is_seeded_and_unknown_depth_stays_unknown():
    depth, config = wall_and_box(), DepthAugmentationConfig()
    for seed in range(20):
        out, again = (augment_depth(depth, config, np.random.default_rng(seed)) for _ in range(2))
        np.testing.assert_array_equal(out, again)
        assert out.dtype == np.float32 and (out[:, 120:] == 0).all() and (out >= 0).all()
    assert (out != augment_depth(depth, config, np.random.default_rng(99))).any()


@pytest.mark.parametrize("window", [0.0, 3.0])
def test_noise_is_up_to_the_kinects(window):
    depth = np.full((128, 128), 1.2, np.float32)
    kinect = 0.0012 + 0.0019 * 0.8**2
    spreads = np.array(
        [
            (augment_depth(depth, only(noise=1.0, window=window), np.random.default_rng(s))).std()
            for s in range(60)
        ]
    )
    assert spreads.max() < 1.15 * kinect
    assert spreads.mean() == pytest.approx(kinect / 2, rel=0.2)


def test_quantization_is_up_to_the_kinects():
    ramp = np.linspace(0.9, 1.1, 128 * 128, dtype=np.float32).reshape(128, 128)
    for seed in range(10):
        out = augment_depth(ramp, only(steps=1.0), np.random.default_rng(seed)).astype(float)
        # An eighth of a pixel of disparity at a meter, z^2 / (8 f b).
        assert np.abs(out - ramp).max() < 1.1**2 / (8 * 572.4 * 0.075) / 2 + 1e-5


def test_missing_depth_at_edges_in_holes_and_single_pixels():
    depth = wall_and_box()
    beside = np.zeros(depth.shape, bool)
    beside[36:94, 26:84] = True
    beside[44:86, 34:76] = False

    def lost(config: DepthAugmentationConfig) -> np.ndarray:
        maps = [augment_depth(depth, config, np.random.default_rng(s)) for s in range(40)]
        return (np.array(maps) == 0)[:, :, :118]

    edges = lost(only(edges=4))
    assert edges[:, ~beside[:, :118]].sum() == 0 and edges[:, beside[:, :118]].mean() > 0.2
    holes = lost(only(holes=1.0)).mean((1, 2))
    assert holes.min() > 0.002 and holes.max() < 0.16
    single = lost(only(lost=0.3)).mean((1, 2))
    assert single.max() < 0.32 and single.mean() == pytest.approx(0.1, abs=0.05)
