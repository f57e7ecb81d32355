"""The sensor's parts, one at a time, against what they are by definition."""

import numpy as np
import pytest
from two_view_pose.envs.simulation.sensor import SensorConfig, SensorState, apply_sensor

GRAY = np.full((120, 160, 3), 128, dtype=np.uint8)


def only(**parts: float) -> SensorConfig:
    """A perfect sensor but for the given parts."""
    names = ("exposure", "white_balance", "gamma", "blur", "noise", "jpeg_probability")
    return SensorConfig(**{**dict.fromkeys(names, 0.0), **parts})


def test_a_perfect_sensor_changes_nothing() -> None:
    image = np.random.default_rng(0).integers(0, 256, (50, 70, 3), dtype=np.uint8)
    out = apply_sensor(image, SensorConfig.none(), np.random.default_rng(1))
    np.testing.assert_array_equal(out, image)
    assert out is not image


def test_same_seed_same_bytes_and_another_seed_others() -> None:
    image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    first, again, other = (
        apply_sensor(image, SensorConfig(), np.random.default_rng(seed)) for seed in (3, 3, 4)
    )
    assert first.dtype == np.uint8 and first.shape == image.shape
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_noise_has_the_standard_deviation_it_should_and_no_bias() -> None:
    spreads = []
    for seed in range(200):
        out = apply_sensor(GRAY, only(noise=8.0), np.random.default_rng(seed)).astype(float)
        spreads.append(out.std())
        assert abs(out.mean() - 128) < 0.3
    # The deviation is uniform in 0 to 8.
    assert np.mean(spreads) == pytest.approx(4.0, rel=0.15)
    assert 7.0 < max(spreads) < 8.4


def test_noise_of_the_channels_is_independent() -> None:
    out = apply_sensor(GRAY, only(noise=8.0), np.random.default_rng(2)).astype(float) - 128
    correlation = np.corrcoef(out.reshape(-1, 3).T)
    np.testing.assert_allclose(correlation, np.eye(3), atol=0.05)


def test_exposure_scales_and_white_balance_leaves_green_alone() -> None:
    means = np.array(
        [
            apply_sensor(GRAY, only(white_balance=0.1), np.random.default_rng(k)).mean((0, 1))
            for k in range(50)
        ]
    )
    assert (means[:, 1] == 128).all()
    assert np.ptp(means[:, 0]) > 15 and np.ptp(means[:, 2]) > 15
    assert np.abs(means / 128 - 1).max() < 0.105
    bright = [
        apply_sensor(GRAY, only(exposure=0.2), np.random.default_rng(k)).mean() for k in range(50)
    ]
    assert 0.79 < min(bright) / 128 < 0.85 and 1.15 < max(bright) / 128 < 1.21


def test_blur_smooths_an_edge_and_keeps_its_place() -> None:
    edge = np.zeros((40, 60, 3), dtype=np.uint8)
    edge[:, 30:] = 200
    out = apply_sensor(edge, only(blur=2.0), np.random.default_rng(5)).astype(float)[20, :, 0]
    assert 20 < out[30] - out[29] < 180
    assert out[29] + out[30] == pytest.approx(200, abs=2)


def test_jpeg_keeps_colors_in_their_channels() -> None:
    red = np.zeros((64, 64, 3), dtype=np.uint8)
    red[..., 0] = 200
    out = apply_sensor(red, only(jpeg_probability=1.0), np.random.default_rng(0))
    np.testing.assert_allclose(out.mean((0, 1)), (200, 0, 0), atol=6)


def test_wrong_input_is_refused() -> None:
    with pytest.raises(ValueError, match="uint8 RGB"):
        apply_sensor(np.zeros((4, 4, 3)), SensorConfig(), np.random.default_rng(0))
    with pytest.raises(ValueError, match="exposure"):
        SensorConfig(exposure=-0.1)
    with pytest.raises(ValueError, match="gamma"):
        SensorConfig(gamma=1.5)
    with pytest.raises(ValueError, match="jpeg_quality"):
        SensorConfig(jpeg_quality=(90, 50))


def test_one_camera_keeps_its_exposure_and_is_not_always_as_sharp() -> None:
    config = SensorConfig(noise=0.0, jpeg_probability=0.0)
    rng = np.random.default_rng(7)
    camera = SensorState.sample(config, rng)
    flat = [camera.resample_blur(config, rng).apply(GRAY, rng) for _ in range(5)]
    assert all((image == flat[0]).all() for image in flat)
    edge = np.zeros((40, 40, 3), dtype=np.uint8)
    edge[:, 20:] = 200
    sharpness = [
        int(camera.resample_blur(config, rng).apply(edge, rng)[20, 19, 1]) for _ in range(20)
    ]
    assert len(set(sharpness)) > 5
    other = SensorState.sample(config, rng).apply(GRAY, rng)
    assert (other != flat[0]).any()
