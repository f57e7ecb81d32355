"""Domain randomization of lights, textures, materials, camera and sensor."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, field

import numpy as np

from ...core.errors import InputError
from ...core.validation import require_range, require_within
from .camera import sphere_direction
from .sensor import SensorConfig
from .textures import PATTERNS, PRINTED, procedural_texture
from .world import LIGHTS, ROOM_TEXTURES, SHAPE_TEXTURE, SHAPE_TEXTURES, World


@dataclass(frozen=True)
class Randomization:
    """Ranges of the domain randomization of an episode; all pairs are (min, max).

    Attributes:
        lights: number of lights, 1 to 3.
        randomize_light_position: whether light positions are sampled.
        light_elevation: of a light seen from the table, radians.
        light_intensity: sum of all lights; 1 renders a white surface white.
        ambient: intensity of ambient light, on the same scale.
        color_temperature: maximum tint of lights towards yellow or blue, 0 to 1.
        shadow_probability: probability that the first light casts shadows.
        textures: whether table, walls, floor and plain shapes get new textures and colors.
        table_patterns: patterns of the table; repeated names are more likely.
        room_patterns: patterns of walls, floor and plain shapes.
        texture_repeat: repeats of the table's texture along its long side.
        material_jitter: maximum absolute change of specularity and shininess.
        brightness_jitter: maximum change of an object's brightness, as a fraction.
        hue_jitter: maximum change of an object's color channels, as a fraction.
        camera_roll: maximum roll of the reference camera, radians.
        look_at_noise: maximum offset of the reference camera's axis from the target, as the tangent
            of the angle.
        sensor: degradation of images.
    """

    lights: tuple[int, int] = (1, 3)
    randomize_light_position: bool = True
    light_elevation: tuple[float, float] = (np.deg2rad(42.0), np.deg2rad(85.0))
    light_intensity: tuple[float, float] = (0.4, 0.75)
    ambient: tuple[float, float] = (0.28, 0.45)
    color_temperature: float = 0.12
    shadow_probability: float = 0.7
    textures: bool = True
    table_patterns: tuple[str, ...] = PATTERNS
    room_patterns: tuple[str, ...] = PATTERNS
    texture_repeat: tuple[float, float] = (1.0, 4.0)
    material_jitter: float = 0.15
    brightness_jitter: float = 0.12
    hue_jitter: float = 0.04
    camera_roll: float = np.deg2rad(12.0)
    look_at_noise: float = 0.15
    sensor: SensorConfig = field(default_factory=SensorConfig)

    def __post_init__(self) -> None:
        require_range(self, 1, LIGHTS, "lights")
        names = ("light_elevation", "light_intensity", "ambient", "texture_repeat")
        require_range(self, 0, np.inf, *names)
        require_within(self, 0, 1, "shadow_probability")
        for name in ("table_patterns", "room_patterns"):
            patterns, known = getattr(self, name), PATTERNS + PRINTED
            for pattern in patterns:
                if pattern not in known:
                    raise InputError(f"{name} must be among {known}, got {pattern!r}")
            if self.textures and not patterns:
                raise InputError(f"{name} must name a pattern, or textures must be False")

    @classmethod
    def strong(cls) -> Randomization:
        """For sim-to-real transfer to photographs of cluttered desks.

        Posters, magazines and calibration boards as textures, wider ranges of light and object
        color, camera roll, sensor noise.
        """
        return cls(
            light_intensity=(0.4, 1.0),
            ambient=(0.28, 0.65),
            color_temperature=0.2,
            table_patterns=PATTERNS + 4 * ("collage",) + 2 * ("markers",),
            room_patterns=PATTERNS + 5 * ("collage",),
            texture_repeat=(0.7, 3.0),
            material_jitter=0.3,
            brightness_jitter=0.3,
            hue_jitter=0.12,
            camera_roll=np.deg2rad(40.0),
            look_at_noise=0.25,
            sensor=SensorConfig(
                exposure=0.3, white_balance=0.12, gamma=0.2, blur=1.3, noise=9.0,
                jpeg_probability=0.5, jpeg_quality=(40, 95),
            ),
        )  # fmt: skip

    @classmethod
    def none(cls) -> Randomization:
        """No randomization: two lights, shadows, plain table, level camera, perfect sensor."""
        return cls(
            lights=(2, 2),
            randomize_light_position=False,
            light_elevation=(np.deg2rad(60.0), np.deg2rad(60.0)),
            light_intensity=(0.6, 0.6),
            ambient=(0.35, 0.35),
            color_temperature=0.0,
            shadow_probability=1.0,
            textures=False,
            material_jitter=0.0,
            brightness_jitter=0.0,
            hue_jitter=0.0,
            camera_roll=0.0,
            look_at_noise=0.0,
            sensor=SensorConfig.none(),
        )


def apply_randomization(world: World, config: Randomization, rng: np.random.Generator) -> list[int]:
    """Randomizes lights, materials and textures of the world's model in place.

    Returns:
        Ids of the textures that changed and must be uploaded.
    """
    _set_lights(world, config, rng)
    _set_objects(world, config, rng)
    if config.textures:
        return _set_textures(world, config, rng)
    return []


def neutral_look(world: World) -> list[int]:
    """Applies :meth:`Randomization.none` with plain colors; returns ids of changed textures."""
    rng = np.random.default_rng(0)
    apply_randomization(world, Randomization.none(), rng)
    colors = {"table": (0.72, 0.70, 0.66), "wall": (0.80, 0.81, 0.80), "floor": (0.45, 0.42, 0.40)}
    changed = []
    for name, size in ROOM_TEXTURES.items():
        pair = np.array([colors[name], colors[name]]) * ((1.0,), (0.8,))
        image = procedural_texture(rng, size, "noise" if name == "table" else "plain", pair)
        changed.append(set_texture(world, name, image))
    gray = np.full((SHAPE_TEXTURE, SHAPE_TEXTURE, 3), 215, np.uint8)
    changed += [set_texture(world, f"shape{i}", gray) for i in range(SHAPE_TEXTURES)]
    for i, material in enumerate(_shape_materials(world)):
        hue = (0.61 * i) % 1.0
        world.model.mat_rgba[material, :3] = colorsys.hsv_to_rgb(hue, 0.45, 0.75)
    return changed


def set_texture(world: World, name: str, image: np.ndarray) -> int:
    """Copies (size, size, 3) uint8 into the texture ``name``; returns its id."""
    texture_pixels(world, name).reshape(-1, *image.shape)[:] = image
    return world.textures[name]


def texture_pixels(world: World, name: str) -> np.ndarray:
    """Returns a view of a texture: (size, size, 3) uint8, a cube's six sides in a column."""
    model, texture = world.model, world.textures[name]
    shape = model.tex_height[texture], model.tex_width[texture], 3
    start = model.tex_adr[texture]
    return model.tex_data[start : start + np.prod(shape)].reshape(shape)


def _set_lights(world: World, config: Randomization, rng: np.random.Generator) -> None:
    model = world.model
    count = int(rng.integers(config.lights[0], config.lights[1] + 1))
    ambient = rng.uniform(*config.ambient)
    power = rng.uniform(*config.light_intensity)
    spread = float(config.randomize_light_position)
    shares = (1.0 - 0.5 * spread * rng.uniform(0.0, 1.0, LIGHTS)) * (np.arange(LIGHTS) < count)
    shares *= power / shares.sum()
    # Axis-aligned: MuJoCo's shadow map has artifacts on a table that it meets obliquely.
    azimuth = np.pi / 2 * rng.integers(4) * spread
    shadows = rng.uniform() < config.shadow_probability
    head = model.vis.headlight
    head.active = 1
    head.ambient[:] = ambient
    head.diffuse[:] = 0.1
    head.specular[:] = 0.05
    for i in range(LIGHTS):
        elevation = rng.uniform(*config.light_elevation)
        angle = azimuth + (i > 0) * (i * 2.1 + spread * rng.uniform(-0.6, 0.6))
        distance = 1.8 + spread * rng.uniform(-0.4, 0.4)
        direction = sphere_direction(angle, elevation)
        warmth = config.color_temperature * rng.uniform(-1.0, 1.0)
        color = np.array([1.0 + warmth, 1.0, 1.0 - warmth])
        model.light_active[i] = i < count
        model.light_pos[i] = distance * direction
        model.light_dir[i] = -direction
        model.light_ambient[i] = 0.0
        model.light_diffuse[i] = shares[i] * color
        model.light_specular[i] = 0.4 * shares[i] * color
        model.light_castshadow[i] = i == 0 and shadows


def _set_objects(world: World, config: Randomization, rng: np.random.Generator) -> None:
    model = world.model
    for name in world.object_names:
        material = world.materials[f"object:{name}"]
        gain = 1.0 + config.brightness_jitter * rng.uniform(-1.0, 1.0)
        tint = 1.0 + config.hue_jitter * rng.uniform(-1.0, 1.0, 3)
        model.mat_rgba[material, :3] = gain * tint
        specular, shininess = config.material_jitter * rng.uniform(-1.0, 1.0, 2)
        base = world.shine[name]
        model.mat_specular[material] = np.clip(base[0] + specular, 0.0, 1.0)
        model.mat_shininess[material] = np.clip(base[1] + shininess, 0.0, 1.0)


def _set_textures(world: World, config: Randomization, rng: np.random.Generator) -> list[int]:
    model = world.model
    changed = []
    for name, size in ROOM_TEXTURES.items():
        patterns = config.table_patterns if name == "table" else config.room_patterns
        pattern = patterns[rng.integers(len(patterns))]
        wooden = rng.uniform() < (0.7 if pattern == "wood" else 0.15)
        colors = _two_colors(rng, 0.5 if name == "table" else 0.35, wooden)
        procedural_texture(rng, size, pattern, colors, texture_pixels(world, name))
        changed.append(world.textures[name])
        repeat = rng.uniform(*config.texture_repeat) if name == "table" else 2.0
        model.mat_texrepeat[world.materials[name]] = repeat
        model.mat_specular[world.materials[name]] = rng.uniform(0.0, 0.25)
        model.mat_shininess[world.materials[name]] = rng.uniform(0.0, 0.6)
    for i in range(SHAPE_TEXTURES):
        pattern = config.room_patterns[rng.integers(len(config.room_patterns))]
        white = np.array([[0.95] * 3, rng.uniform(0.3, 0.95, 3)])
        image = procedural_texture(rng, SHAPE_TEXTURE, pattern, white)
        changed.append(set_texture(world, f"shape{i}", image))
    for material in _shape_materials(world):
        hue, saturation, value = rng.uniform((0.0, 0.0, 0.3), (1.0, 0.85, 1.0))
        model.mat_rgba[material, :3] = colorsys.hsv_to_rgb(hue, saturation, value)
        model.mat_specular[material] = rng.uniform(0.0, 0.6)
        model.mat_shininess[material] = rng.uniform(0.0, 0.8)
    return changed


def _shape_materials(world: World) -> list[int]:
    return [world.materials[f"shape{i}"] for i in range(len(world.shape_geoms))]


def _two_colors(rng: np.random.Generator, contrast: float, wooden: bool) -> np.ndarray:
    """Samples two related colors of furniture: wood, gray, rarely saturated; (2, 3) in [0, 1]."""
    hue = rng.uniform(0.05, 0.11) if wooden else rng.uniform()
    saturation = rng.uniform(0.25, 0.65) if wooden else rng.beta(0.8, 6.0)
    value = rng.uniform(0.25, 0.88)
    other = np.clip(value + rng.choice((-1.0, 1.0)) * rng.uniform(0.05, contrast), 0.08, 0.92)
    hues = hue, (hue + rng.normal(0.0, 0.03)) % 1.0
    pairs = zip(hues, (value, other), strict=True)
    return np.array([colorsys.hsv_to_rgb(h, saturation, v) for h, v in pairs])
