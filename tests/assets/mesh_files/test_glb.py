"""Colors of GLB files against the glTF 2.0 specification."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.mesh_files import CORNERS, RED, colors_of, png, write_glb
from two_view_pose.assets.mesh_files import read_parts
from two_view_pose.assets.surface_colors import sample_colors

LINEAR = [0.5776, 0.0212, 0.0212]
"""RED in linear light, by the sRGB standard (IEC 61966-2-1)."""

MIDDLE = np.full((4, 2), 0.5, np.float32)


def material(**values: Any) -> dict[str, Any]:
    return {"pbrMetallicRoughness": values}


def plain(color: list[float], count: int = 4) -> np.ndarray:
    return np.tile(np.array(color, np.float32), (count, 1))


def test_base_color_is_linear(tmp_path: Path) -> None:
    path = write_glb(tmp_path / "a.glb", material(baseColorFactor=[*LINEAR, 1]))
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


@pytest.mark.parametrize(
    "colors",
    [
        plain(LINEAR),
        plain([*LINEAR, 0.5]),
        np.round(255 * plain(LINEAR)).astype(np.uint8)[:, :3],
        np.round(65535 * plain([*LINEAR, 1])).astype(np.uint16),
    ],
)
@pytest.mark.parametrize("factor", [None, 0.5])
def test_vertex_colors_multiply_the_material(
    tmp_path: Path, colors: np.ndarray, factor: float | None
) -> None:
    if colors.dtype == np.uint8:  # rows start at multiples of four bytes
        colors = np.column_stack([colors, np.full(4, 255, np.uint8)])
    given = None if factor is None else material(baseColorFactor=[factor] * 3 + [1])
    path = write_glb(tmp_path / "a.glb", given, {"COLOR_0": colors})
    half = np.array(LINEAR) * (factor or 1)  # 147, 28, 28 for a half
    expected = 255 * np.where(half > 0.0031, 1.055 * half ** (1 / 2.4) - 0.055, 12.92 * half)
    np.testing.assert_allclose(colors_of(path), [expected] * 4, atol=2)


def test_texture_times_factor(tmp_path: Path) -> None:
    given = material(baseColorFactor=[0.1441, 1, 1, 1], baseColorTexture={"index": 0})
    # 0.1441 is 106 in sRGB, and white times it is that; 255 * 0.1441 would be 37.
    path = write_glb(tmp_path / "a.glb", given, {"TEXCOORD_0": MIDDLE}, (png((255, 255, 40)),))
    np.testing.assert_allclose(colors_of(path), [(106, 255, 40)] * 4, atol=0.6)


def test_second_texture_coordinates_and_normalized_ones(tmp_path: Path) -> None:
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:32, 32:] = RED  # u > 0.5, v < 0.5 as glTF has them, from the top
    uv = np.tile(np.array([49152, 16384], np.uint16), (4, 1))
    given = material(baseColorTexture={"index": 0, "texCoord": 1})
    attributes = {"TEXCOORD_0": np.zeros((4, 2), np.float32), "TEXCOORD_1": uv}
    path = write_glb(tmp_path / "a.glb", given, attributes, (png(pixels),))
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


@pytest.mark.parametrize(
    ("transform", "place"),
    [
        ({"offset": [0.5, 0.0]}, (0.8, 0.1)),
        ({"scale": [3.0, 5.0]}, (0.9, 0.5)),
        # Counter-clockwise as seen, v down: right becomes up, which is -v, and down becomes right.
        ({"rotation": np.pi / 2}, (0.1, 0.7)),
        ({"rotation": np.pi / 2, "scale": [1, 3], "offset": [0.25, 0.0]}, (0.55, 0.7)),
        ({"texCoord": 1}, (0.85, 0.6)),
    ],
)
@pytest.mark.parametrize("required", [[], ["KHR_texture_transform"]])
def test_texture_transform(
    tmp_path: Path, transform: dict[str, Any], place: tuple[float, float], required: list[str]
) -> None:
    x, y = np.meshgrid(np.arange(256), np.arange(256))
    image = png(np.dstack([x, y, 0 * x]))  # red is u, green is v
    given = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    attributes = {"TEXCOORD_0": plain([0.3, 0.1]), "TEXCOORD_1": plain([0.85, 0.6])}
    path = write_glb(
        tmp_path / "a.glb", material(baseColorTexture=given), attributes, (image,),
        extensionsRequired=required,
    )  # fmt: skip
    np.testing.assert_allclose(colors_of(path)[0, :2], 256 * np.array(place), atol=1)


@pytest.mark.parametrize(("mode", "seen"), [(10497, 0), (33071, 1), (33648, 1)])
def test_wrapping(tmp_path: Path, mode: int, seen: int) -> None:
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[:, 2:] = RED
    path = write_glb(
        tmp_path / "a.glb", material(baseColorTexture={"index": 0}),
        {"TEXCOORD_0": plain([1.25, 0.5])}, (png(pixels),),
        textures=[{"source": 0, "sampler": 0}], samplers=[{"wrapS": mode, "wrapT": mode}],
    )  # fmt: skip
    np.testing.assert_allclose(colors_of(path), [np.array(RED) * seen] * 4, atol=0.5)


def test_specular_glossiness(tmp_path: Path) -> None:
    name = "KHR_materials_pbrSpecularGlossiness"
    for glossy, images in (
        ({"diffuseFactor": [*LINEAR, 1], "specularFactor": [0, 0, 0]}, ()),
        ({"diffuseTexture": {"index": 0}}, (png(RED),)),
        ({"diffuseFactor": [0, 0, 0, 1], "specularFactor": LINEAR}, ()),  # a metal
    ):
        given = {"extensions": {name: glossy}}
        path = write_glb(
            tmp_path / "a.glb", given, {"TEXCOORD_0": MIDDLE}, images, extensionsRequired=[name]
        )
        np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


def test_emission_is_added(tmp_path: Path) -> None:
    given = material(baseColorFactor=[0, 0, 0, 1]) | {"emissiveFactor": LINEAR}
    np.testing.assert_allclose(colors_of(write_glb(tmp_path / "a.glb", given)), [RED] * 4, atol=0.5)


@pytest.mark.parametrize(
    ("mode", "opacity", "seen"),
    [
        ("OPAQUE", 0, True),
        ("MASK", 120, False),
        ("MASK", 140, True),
        ("BLEND", 60, False),
        ("BLEND", 255, True),
    ],
)
def test_opacity(tmp_path: Path, mode: str, opacity: int, seen: bool) -> None:
    given = material(baseColorTexture={"index": 0}) | {"alphaMode": mode, "name": "glass"}
    image = png((*RED, opacity))
    path = write_glb(tmp_path / "a.glb", given, {"TEXCOORD_0": MIDDLE}, (image,))
    if seen:
        np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)
    else:
        with pytest.raises(ValueError, match="material 'glass' is transparent on 100 %"):
            sample_colors(read_parts(path), 100)


@pytest.mark.parametrize("name", ["skin.png", "SKIN.png", "red%20skin.png"])
def test_images_outside(tmp_path: Path, name: str) -> None:
    (tmp_path / name.replace("%20", " ").replace("SKIN", "skin")).write_bytes(png(RED))
    given = material(baseColorTexture={"index": 0})
    path = write_glb(tmp_path / "a.glb", given, {"TEXCOORD_0": MIDDLE}, ({"uri": name},))
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


def test_quantized_positions(tmp_path: Path) -> None:
    stored = np.round(CORNERS * 10 * 32767).astype(np.int16)
    stored = np.column_stack([stored, np.zeros(4, np.int16)])[:, :3].copy()
    path = write_glb(
        tmp_path / "a.glb", position=stored, nodes=[{"mesh": 0, "scale": [0.1] * 3}],
        extensionsRequired=["KHR_mesh_quantization"],
    )  # fmt: skip
    (part,) = read_parts(path)
    np.testing.assert_allclose(part.mesh.vertices, CORNERS, atol=1e-6)


def test_parts_keep_their_places_and_colors(tmp_path: Path) -> None:
    part = {"attributes": {"POSITION": 0}, "indices": 1}
    header = {
        "materials": [material(baseColorFactor=[*LINEAR, 1]), material()],
        "meshes": [
            {"primitives": [part | {"material": 0}, part | {"material": 1}]},
        ],
        "nodes": [{"translation": [1, 2, 3], "children": [1]}, {"mesh": 0, "scale": [2, 2, 2]}],
    }  # fmt: skip
    path = write_glb(tmp_path / "a.glb", **header)
    parts = read_parts(path)
    for part in parts:
        np.testing.assert_allclose(part.mesh.bounds, [[1, 2, 3], [1.2, 2.2, 3.2]], atol=1e-6)
    np.testing.assert_allclose(colors_of(path), [RED] * 4 + [(255,) * 3] * 4, atol=0.5)


def test_trimesh_writes_vertex_colors_as_they_are(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((0.1, 0.1, 0.1))
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=[(*RED, 255)] * 8)
    mesh.export(tmp_path / "a.glb")
    np.testing.assert_allclose(colors_of(tmp_path / "a.glb"), [RED] * 12, atol=0.5)


@pytest.mark.parametrize(
    ("header", "images", "message"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, (), "needs .*KHR_draco_mesh"),
        ({"extensionsRequired": ["EXT_strange"]}, (), "extension EXT_strange, which is not"),
        (
            {"textures": [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]},
            ({"uri": "a.ktx2"},),
            r"unsupported type \(KHR_texture_basisu\)",
        ),
        ({}, (b"no image",), "is not an image that can be read"),
        ({}, ({"uri": "gone.png"},), "names the texture 'gone.png', which is not in"),
    ],
)
def test_what_cannot_be_read_is_refused(
    tmp_path: Path, header: dict[str, Any], images: tuple[Any, ...], message: str
) -> None:
    given = material(baseColorTexture={"index": 0}) if images else None
    path = write_glb(tmp_path / "a.glb", given, {"TEXCOORD_0": MIDDLE}, images, **header)
    with pytest.raises(ValueError, match=message):
        read_parts(path)


def test_a_texture_without_coordinates_is_refused(tmp_path: Path) -> None:
    given = material(baseColorTexture={"index": 0, "texCoord": 1}) | {"name": "paint"}
    path = write_glb(tmp_path / "a.glb", given, {"TEXCOORD_0": MIDDLE}, (png(RED),))
    with pytest.raises(ValueError, match=r"'paint' has a texture, but .* no TEXCOORD_1"):
        read_parts(path)


@pytest.mark.parametrize(
    "given",
    [
        material(baseColorFactor=[1, 0.5, 0.5]),
        material(baseColorFactor=[1, 0.5, float("nan"), 1]),
        material() | {"emissiveFactor": [1, 0.5]},
        material() | {"alphaMode": "MASK", "alphaCutoff": "half"},
    ],
)
def test_materials_of_other_numbers_are_refused(tmp_path: Path, given: dict[str, Any]) -> None:
    path = write_glb(tmp_path / "a.glb", given)
    with pytest.raises(ValueError, match=r"a\.glb, material 0.* (not finite|no number)"):
        read_parts(path)
