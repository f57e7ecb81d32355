"""Colors of PLY files: every name, type and range that is found in the wild."""

from pathlib import Path

import numpy as np
import pytest
from helpers.mesh_files import RED, colors_of, png, write_ply
from two_view_pose.assets.mesh_files import read_parts

WAYS = [
    ("uchar", "200 40 40"),
    ("ushort", "200 40 40"),
    ("ushort", "51400 10280 10280"),
    ("int", "200 40 40"),
    ("float", "0.784 0.157 0.157"),
    ("float", "200 40 40"),
    ("double", "51400 10280 10280"),
]


def properties(kind: str, names: str = "red green blue") -> tuple[str, ...]:
    return tuple(f"{kind} {name}" for name in names.split())


@pytest.mark.parametrize(("kind", "values"), WAYS)
@pytest.mark.parametrize(
    "names", ["red green blue", "diffuse_red diffuse_green diffuse_blue", "r g b", "Red Green Blue"]
)
def test_colors_of_vertices_and_faces(tmp_path: Path, kind: str, values: str, names: str) -> None:
    vertices = write_ply(tmp_path / "v.ply", properties(kind, names), values)
    np.testing.assert_allclose(colors_of(vertices), [RED] * 4, atol=0.5)
    faces = write_ply(tmp_path / "f.ply", face=properties(kind, names), face_values=values)
    np.testing.assert_allclose(colors_of(faces), [RED] * 4, atol=0.5)


def test_white_vertices_do_not_hide_colored_faces(tmp_path: Path) -> None:
    color = properties("uchar")
    path = write_ply(tmp_path / "a.ply", color, "255 255 255", color, "200 40 40")
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)
    path = write_ply(tmp_path / "b.ply", color, "200 40 40", color, "255 255 255")
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)
    path = write_ply(tmp_path / "white.ply", color, "255 255 255")
    np.testing.assert_allclose(colors_of(path), 255)


def test_texture_coordinates_without_a_texture_do_not_hide_colors(tmp_path: Path) -> None:
    vertex = (*properties("float", "texture_u texture_v"), *properties("uchar"))
    path = write_ply(tmp_path / "part.ply", vertex, "0.5 0.5 200 40 40")
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


@pytest.mark.parametrize("name", ["skin.png", "SKIN.png", r"tex\skin.png", "häut.png"])
def test_textures(tmp_path: Path, name: str) -> None:
    (tmp_path / ("häut.png" if "ä" in name else "skin.png")).write_bytes(png(RED))
    uv = properties("float", "texture_u texture_v")
    path = write_ply(tmp_path / "part.ply", uv, "0.5 0.5", comment=f"comment TextureFile {name}")
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


@pytest.mark.parametrize(
    ("vertex", "values", "comment", "message"),
    [
        (
            properties("float", "s t"),
            "0 0",
            "comment TextureFile gone.png",
            "texture 'gone.png', w",
        ),
        ((), "", "comment TextureFile skin.png", "no texture coordinates"),
        (properties("float"), "-0.5 0 0", "comment", "colors from -0.5 to 0"),
        (properties("float"), "nan 0 0", "comment", "colors from nan"),
        (properties("float"), "1e9 0 0", "comment", r"colors from 0 to 1e\+09"),
    ],
)
def test_what_cannot_be_read_is_refused(
    tmp_path: Path, vertex: tuple[str, ...], values: str, comment: str, message: str
) -> None:
    path = write_ply(tmp_path / "part.ply", vertex, values, comment=comment)
    with pytest.raises(ValueError, match=message):
        read_parts(path)
    assert len(read_parts(path, colors=False)[0].mesh.faces) == 4


def test_comments_in_latin_1(tmp_path: Path) -> None:
    path = write_ply(tmp_path / "a.ply", properties("uchar"), "200 40 40", comment="comment für")
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


@pytest.mark.parametrize("value", ["nan", "inf", "1e30"])
def test_numbers_that_no_integer_holds_are_refused(tmp_path: Path, value: str) -> None:
    path = write_ply(tmp_path / "part.ply", properties("uchar"), f"{value} 40 40")
    with pytest.raises(ValueError, match=r"part\.ply has NaN, infinite or too large"):
        read_parts(path)
