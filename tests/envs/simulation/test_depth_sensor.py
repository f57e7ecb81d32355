"""The depth sensor's parts, one at a time, against what they are by definition."""

import cv2
import numpy as np
import pytest
from two_view_pose.envs.datagen.generate import GenerateConfig, generate
from two_view_pose.envs.simulation.depth_sensor import (
    DepthSensorConfig,
    apply_depth_sensor,
    axial_deviation,
    projector_shadow,
    viewing_angles,
)
from two_view_pose.pose_estimator.bop import dataset as bop

K = np.array([[572.4, 0.0, 320.0], [0.0, 573.6, 240.0], [0.0, 0.0, 1.0]])


def only(**parts: float) -> DepthSensorConfig:
    """A perfect sensor but for the given parts."""
    perfect = {
        "axial": 0.0, "lateral": 0.0, "disparity_step": 0.0, "baseline": 0.0, "grazing": 90.0,
        "edge_loss": 0.0, "min_depth": 0.0, "max_depth": 1e3,
    }  # fmt: skip
    return DepthSensorConfig(**{**perfect, **parts})


def plane(normal: tuple[float, float, float], distance: float, shape=(480, 640)) -> np.ndarray:
    """Depth of the plane through (0, 0, distance), by intersecting each ray."""
    rows, columns = np.indices(shape)
    rays = np.stack([columns, rows, np.ones(shape)], -1) @ np.linalg.inv(K).T
    return (distance * normal[2] / (rays @ np.array(normal))).astype(np.float32)


def box_before_wall(near: float = 0.8, far: float = 1.2) -> np.ndarray:
    depth = np.full((480, 640), far, np.float32)
    depth[150:300, 200:350] = near
    return depth


def test_a_perfect_sensor_changes_nothing():
    depth = box_before_wall()
    depth[:5] = 0
    np.testing.assert_allclose(
        apply_depth_sensor(depth, K, only(), np.random.default_rng(0)), depth
    )


def test_same_seed_same_bytes_and_another_seed_others():
    depth = box_before_wall()
    first, again, other = (
        apply_depth_sensor(depth, K, DepthSensorConfig(), np.random.default_rng(s))
        for s in (1, 1, 2)
    )
    assert first.dtype == np.float32 and first.shape == depth.shape
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("z", [0.7, 1.0, 1.4])
def test_axial_noise_of_a_wall_matches_nguyen(z):
    depth = np.full((240, 320), z, np.float32)
    out = apply_depth_sensor(depth, K, DepthSensorConfig(), np.random.default_rng(0))
    out = out[out > 0]
    assert len(out) > 0.99 * depth.size
    assert out.std() == pytest.approx(0.0012 + 0.0019 * (z - 0.4) ** 2, rel=0.06)
    assert out.mean() == pytest.approx(z, abs=2e-4)


def test_depth_comes_in_eighths_of_a_pixel_of_disparity():
    out = apply_depth_sensor(
        plane((0.3, 0.2, -1.0), 1.0), K, DepthSensorConfig(), np.random.default_rng(0)
    )
    eighths = 8 * K[0, 0] * 0.075 / out[out > 0].astype(float)
    np.testing.assert_allclose(eighths, np.round(eighths), atol=1e-3)
    assert len(np.unique(np.round(eighths))) > 20


def test_depth_noise_is_correlated_between_neighbors_only():
    depth = np.full((300, 400), 1.0, np.float32)
    noise = apply_depth_sensor(depth, K, only(axial=1.0), np.random.default_rng(0)) - 1
    beside = np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]
    apart = np.corrcoef(noise[:, 8:].ravel(), noise[:, :-8].ravel())[0, 1]
    assert beside > 0.6 and abs(apart) < 0.02


@pytest.mark.parametrize("normal", [(0, 0, -1.0), (0.8, 0, -1.0), (0.5, -1.2, -0.7)])
def test_viewing_angles_are_those_of_the_plane(normal):
    depth = plane(normal, 1.0, (200, 200))[50:150, 50:150]
    camera = K.copy()
    camera[:2, 2] -= 50
    rows, columns = np.indices(depth.shape)
    rays = np.stack([columns, rows, np.ones(depth.shape)], -1) @ np.linalg.inv(camera).T
    cosine = -(rays @ np.array(normal)) / np.linalg.norm(rays, axis=-1) / np.linalg.norm(normal)
    np.testing.assert_allclose(viewing_angles(depth, camera), np.arccos(cosine), atol=0.02)


def test_grazing_surfaces_are_lost_and_others_are_not():
    def seen(degrees: float) -> float:
        tilt = np.radians(degrees)
        depth = plane((0, np.sin(tilt), -np.cos(tilt)), 1.0)[236:244, 316:324]
        camera = K - [[0, 0, 316], [0, 0, 236], [0, 0, 0]]
        out = [
            apply_depth_sensor(depth, camera, only(grazing=80.0), np.random.default_rng(s))
            for s in range(40)
        ]
        return float(np.mean(np.array(out) > 0))

    assert seen(60) == 1.0
    assert seen(80) == pytest.approx(0.5, abs=0.1)
    assert seen(88) < 0.05


def test_the_projector_on_the_right_leaves_a_shadow_on_the_left():
    shadow = projector_shadow(box_before_wall(), K, 0.075)
    # The box's left rim stands at column 200; its projector ray meets the wall further left by the
    # difference of the disparities.
    width = K[0, 0] * 0.075 * (1 / 0.8 - 1 / 1.2)
    columns = np.flatnonzero(shadow[200])
    assert columns.max() == 199
    assert len(columns) == pytest.approx(width, abs=1)
    assert not shadow[:150].any() and not shadow[300:].any() and not shadow[:, 200:].any()


def test_pixels_beside_edges_are_lost_or_see_the_other_surface():
    depth = box_before_wall()
    rim = cv2.morphologyEx(
        (depth < 1).astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((5, 5), np.uint8)
    ).astype(bool)
    lossy = apply_depth_sensor(depth, K, only(edge_loss=0.5), np.random.default_rng(0))
    assert 0.3 < (lossy[rim] == 0).mean() < 0.6
    np.testing.assert_array_equal(lossy[~rim], depth[~rim])
    moved = apply_depth_sensor(depth, K, only(lateral=1.0), np.random.default_rng(0)) != depth
    assert 0.05 < moved[rim].mean() < 0.4 and moved[~rim].mean() < 1e-3


def test_depth_out_of_range_is_missing():
    depth = np.full((40, 60), 1.0, np.float32)
    depth[:, :20], depth[:, 40:] = 0.3, 6.0
    depth[:10] = 0
    sensor = only(min_depth=0.4, max_depth=5.0)
    out = apply_depth_sensor(depth, K, sensor, np.random.default_rng(0))
    np.testing.assert_array_equal(out > 0, depth == 1)


def test_nguyens_formula_at_points_of_the_paper():
    assert axial_deviation(np.array(0.4), np.array(0.2)) == pytest.approx(0.0012)
    tilted = axial_deviation(np.array(1.0), np.radians(75.0)) - axial_deviation(
        np.array(1.0), np.radians(45.0)
    )
    assert tilted == pytest.approx(0.0001 * (75 / 15) ** 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"axial": -1.0}, "axial must be >= 0"),
        ({"edge_loss": 1.5}, "edge_loss must be 0 to 1"),
        ({"grazing": 120.0}, "grazing must be > 0"),
        ({"min_depth": 6.0}, "max_depth must be > min_depth"),
        ({"baseline": 0.0}, "disparity_step needs a baseline"),
    ],
)
def test_wrong_settings_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        DepthSensorConfig(**change)


def test_wrong_depth_is_refused():
    with pytest.raises(ValueError, match="must not be negative"):
        apply_depth_sensor(-np.ones((4, 4)), K, DepthSensorConfig(), np.random.default_rng(0))


@pytest.mark.slow
def test_generated_depth_passes_the_sensor_and_nothing_else_changes(tmp_path):
    def make(name: str, **depth: bool) -> list[bop.BopImage]:
        config = GenerateConfig(
            tmp_path / name, scenes=1, views=2, objects=("duck",), width=160, height=120,
            workers=1, seed=3, **depth,
        )  # fmt: skip
        generate(config)
        return list(bop.read_dataset(config.out, config.split))

    without, exact, noisy = (
        make("without"), make("exact", depth=True), make("noisy", depth=True, depth_noise=True)
    )  # fmt: skip
    maps = [[bop.read_depth(image) for image in images] for images in (exact, noisy)]
    for plain, clean, rough, true, seen in zip(without, exact, noisy, *maps, strict=True):
        images = [bop.read_rgb(image) for image in (plain, clean, rough)]
        np.testing.assert_array_equal(images[0], images[1])
        np.testing.assert_array_equal(images[0], images[2])
        np.testing.assert_array_equal(
            plain.annotations[0].T_cam_obj, rough.annotations[0].T_cam_obj
        )
        known = (seen > 0) & (true < 2)
        assert known.mean() > 0.5 and (seen[true < 2] == 0).any()
        assert 5e-4 < np.median(np.abs(seen - true)[known]) < 5e-3
    assert (maps[1][0] != maps[1][1]).any()


def test_noise_without_depth_is_refused(tmp_path):
    with pytest.raises(ValueError, match="depth_noise needs depth"):
        GenerateConfig(tmp_path, depth_noise=True)
