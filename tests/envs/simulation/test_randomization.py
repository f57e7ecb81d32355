"""Looks: what changes, what stays, and what a texture promises."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.envs.simulation.randomization import Randomization, apply_randomization
from two_view_pose.envs.simulation.scene import Scene
from two_view_pose.envs.simulation.sensor import SensorConfig
from two_view_pose.envs.simulation.textures import PATTERNS, PRINTED, procedural_texture
from two_view_pose.envs.simulation.world import LIGHTS, World, compile_world

COLORS = np.array([[0.1, 0.2, 0.3], [0.9, 0.8, 0.7]])


@pytest.fixture(scope="module")
def world(objects: dict[str, ObjectModel]) -> Iterator[World]:
    """A compiled world of the primitives."""
    yield compile_world(objects)


def looks(world: World) -> list[np.ndarray]:
    """All that a look consists of."""
    m = world.model
    arrays = [m.light_pos, m.light_dir, m.light_diffuse, m.light_active, m.light_castshadow]
    arrays += [m.mat_rgba, m.mat_specular, m.mat_shininess, m.mat_texrepeat, m.tex_data]
    return [a.copy() for a in (*arrays, m.vis.headlight.ambient)]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_textures_keep_to_their_colors_and_tile(pattern: str) -> None:
    for seed in range(3):
        image = procedural_texture(np.random.default_rng(seed), 256, pattern, COLORS)
        assert image.shape == (256, 256, 3) and image.dtype == np.uint8
        low, high = 255 * COLORS
        assert (image >= np.minimum(low, high) - 1).all()
        assert (image <= np.maximum(low, high) + 1).all()
        if pattern in ("checker", "speckle"):
            continue  # sharp edges within: a seam is no sharper
        values = image.astype(int).sum(axis=2)
        for axis in (0, 1):
            steps = np.abs(np.diff(values, axis=axis)).max()
            seam = np.abs(values.take(0, axis) - values.take(-1, axis)).max()
            assert seam <= 1.5 * steps + 3


@pytest.mark.parametrize("pattern", PATTERNS)
def test_textures_allocate_little_temporary_memory(pattern: str) -> None:
    """Arrays of many megabytes at every reset are what fragments a long run's heap."""
    first = procedural_texture(np.random.default_rng(0), 512, pattern, COLORS)
    tracemalloc.start()
    image = procedural_texture(np.random.default_rng(0), 512, pattern, COLORS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2 * image.nbytes
    assert np.array_equal(image, first) and not np.shares_memory(image, first)


@pytest.mark.parametrize("pattern", PRINTED)
def test_printed_textures_have_their_own_colors(pattern: str) -> None:
    gray = np.full((2, 3), 0.5)
    image = procedural_texture(np.random.default_rng(0), 128, pattern, gray)
    assert image.shape == (128, 128, 3) and image.std() > 20


@pytest.mark.slow
def test_strong_randomization_is_stronger_than_default(world: World) -> None:
    """Colors of the table beyond wood and gray, and light that whitens."""

    def strongest(randomization: Randomization) -> list[float]:
        colorful = []
        for seed in range(12):
            apply_randomization(world, randomization, np.random.default_rng(seed))
            start = world.model.tex_adr[world.textures["table"]]
            table = world.model.tex_data[start : start + 3 * 512 * 512].reshape(-1, 3).astype(int)
            colorful.append(float(np.quantile(np.ptp(table, axis=1), 0.9)))
        return colorful

    assert max(strongest(Randomization.strong())) > 1.3 * max(strongest(Randomization()))
    with pytest.raises(ValueError, match=r"room_patterns must be among .*collage.*'tartan'"):
        Randomization(room_patterns=("tartan",))


def test_an_unknown_pattern_is_refused() -> None:
    with pytest.raises(ValueError, match="pattern"):
        procedural_texture(np.random.default_rng(0), 64, "tartan", COLORS)


def test_randomization_depends_on_the_seed_only(world: World) -> None:
    seen = []
    for seed in (1, 2, 1):
        apply_randomization(world, Randomization(), np.random.default_rng(seed))
        seen.append(looks(world))
    for first, again in zip(seen[0], seen[2], strict=True):
        np.testing.assert_array_equal(first, again)
    assert sum(not np.array_equal(a, b) for a, b in zip(seen[0], seen[1], strict=True)) >= 9


def test_only_changed_textures_are_named(world: World) -> None:
    before = world.model.tex_data.copy()
    changed = apply_randomization(world, Randomization(), np.random.default_rng(11))
    differs = world.model.tex_data != before
    for texture in range(world.model.ntex):
        start = world.model.tex_adr[texture]
        size = world.model.tex_height[texture] * world.model.tex_width[texture] * 3
        assert differs[start : start + size].any() == (texture in changed)
    none = apply_randomization(world, Randomization(textures=False), np.random.default_rng(12))
    assert none == []


def test_lights_keep_to_the_configuration(world: World) -> None:
    config = Randomization(lights=(2, 2), shadow_probability=0.0, light_intensity=(0.5, 0.6))
    model = world.model
    for seed in range(10):
        apply_randomization(world, config, np.random.default_rng(seed))
        assert model.light_active.sum() == 2 and len(model.light_active) == LIGHTS
        assert not model.light_castshadow.any()
        assert 0.5 <= model.light_diffuse[:, 1].sum() <= 0.6
        lit = model.light_active.astype(bool)
        directions = model.light_pos / np.linalg.norm(model.light_pos, axis=1, keepdims=True)
        elevation = np.arcsin(directions[lit, 2])
        assert (elevation >= config.light_elevation[0] - 1e-6).all()
        np.testing.assert_allclose(model.light_dir[lit], -directions[lit], atol=1e-6)


def test_object_colors_stay_near_their_own(world: World) -> None:
    config = Randomization(brightness_jitter=0.1, hue_jitter=0.05, material_jitter=0.1)
    material = world.materials["object:brick"]
    for seed in range(20):
        apply_randomization(world, config, np.random.default_rng(seed))
        rgb = world.model.mat_rgba[material, :3]
        assert (np.abs(rgb - 1) < 1.1 * 1.05 - 1 + 1e-6).all()
        assert np.ptp(rgb / rgb.mean()) < 0.11
        assert abs(world.model.mat_specular[material] - 0.2) <= 0.1 + 1e-6


def test_no_randomization_is_the_same_for_every_seed(objects: dict[str, ObjectModel]) -> None:
    config = Randomization.none()
    assert config.sensor == SensorConfig.none()
    assert config.camera_roll == config.look_at_noise == 0
    scene = Scene(objects, randomization=config)
    first = looks(scene.world)
    apply_randomization(scene.world, config, np.random.default_rng(9))
    for a, b in zip(first, looks(scene.world), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("lights", (0, 2)),
        ("lights", (1, 9)),
        ("light_intensity", (0.8, 0.2)),
        ("shadow_probability", 1.2),
        ("table_patterns", ("tartan",)),
        ("table_patterns", ()),
    ],
)
def test_impossible_configurations_are_refused(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        Randomization(**{field: value})
