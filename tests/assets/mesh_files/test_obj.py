"""Colors of OBJ files against the format's specification."""

from pathlib import Path

import numpy as np
import pytest
from helpers.mesh_files import RED, colors_of, png, write_obj
from two_view_pose.assets.mesh_files import read_parts

MATERIAL = "mtllib part.mtl\nusemtl paint"


def write_material(path: Path, lines: str) -> Path:
    """The tetrahedron with a material of these lines."""
    (path.parent / "part.mtl").write_bytes(f"newmtl paint\n{lines}\n".encode("latin-1"))
    return write_obj(path, lines=MATERIAL)


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("skin.png", "skin.png"),
        ("Skin.PNG", "skin.png"),
        ("tex/skin.png", r"tex\skin.png"),
        ("Tex/skin.png", r".\tex\SKIN.png"),
        ("../skin.png", "../skin.png"),
        ("skin.png", r"C:\Users\me\skin.png"),
        ("skin.png", "/home/me/textures/skin.png"),
        ("red skin.png", "red skin.png"),
        ("red skin.png", "red%20skin.png"),
        ("häut.png", "häut.png"),
        ("skin.png", "-s 1 1 1 -o 0 0 0 -clamp on skin.png"),
        ("my skin.png", "-blendu off -mm 0 1 -imfchan m -o 0.5 my skin.png"),
        ("2.png", "-s 1 1 2.png"),
    ],
)
def test_textures_are_found(tmp_path: Path, file: str, name: str) -> None:
    folder = tmp_path / "model"
    for place in (folder, (folder / file).parent):
        place.mkdir(exist_ok=True)
    (folder / file).write_bytes(png(RED))
    path = write_material(folder / "part.obj", f"Kd 1 1 1\n  map_Kd {name}  ")
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


def test_options_move_the_texture(tmp_path: Path) -> None:
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:32, :32] = RED  # u < 0.5, v > 0.5
    (tmp_path / "skin.png").write_bytes(png(pixels))
    # All of the texture coordinates are scaled to a tenth, then moved to that quarter.
    path = write_material(tmp_path / "part.obj", "map_Kd -o 0.2 0.7 -s 0.1 0.1 0.1 skin.png")
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("map_Kd gone.png", r"names the texture 'gone\.png', which is not in .*remove map_Kd"),
        ("map_Kd part.mtl", r"part\.mtl, the texture of .*part\.obj, is not an image"),
        ("map_Kd -mm 0.2 1 part.png", "map_Kd with -mm"),
        ("map_Kd -imfchan r part.png", "channel 'r'"),
        ("map_Kd -s 1 1 1", "names no file|which is not in"),
        ("Kd spectral red.rfl", "Kd spectral red.rfl is not a color"),
        ("Kd -1 0 0", "colors from -1 to 0"),
        ("map_Kd -s 1 inf 1 part.png", r"part\.obj.* texture coordinates that are not finite"),
    ],
)
def test_what_cannot_be_read_is_refused(tmp_path: Path, lines: str, message: str) -> None:
    (tmp_path / "part.png").write_bytes(png(RED))
    path = write_material(tmp_path / "part.obj", lines)
    with pytest.raises(ValueError, match=message):
        read_parts(path)
    assert len(read_parts(path, colors=False)[0].mesh.faces) == 4


def test_missing_libraries_and_materials_are_refused(tmp_path: Path) -> None:
    path = write_obj(tmp_path / "part.obj", lines=MATERIAL)
    with pytest.raises(ValueError, match=r"names the material file 'part\.mtl', which is not in"):
        read_parts(path)
    (tmp_path / "part.mtl").write_text("newmtl other\nKd 1 0 0\n")
    with pytest.raises(ValueError, match=r"uses the material 'paint', which part\.mtl does not"):
        read_parts(path)
    (tmp_path / "part.mtl").write_text("newmtl paint\nmap_Kd part.png\n")
    (tmp_path / "part.png").write_bytes(png(RED))
    without = write_obj(tmp_path / "part.obj", lines=MATERIAL, faces="f {0} {1} {2}")
    with pytest.raises(ValueError, match=r"not all of its faces have texture coordinates"):
        read_parts(without)


def test_libraries_are_many_and_their_names_have_spaces_and_other_case(tmp_path: Path) -> None:
    (tmp_path / "First.mtl").write_text("newmtl Blue\nKd 0 0 1\n")
    (tmp_path / "my part.mtl").write_text("newmtl Paint\nKD 0.784 0.157 0.157\n")
    path = write_obj(
        tmp_path / "part.obj", lines="mtllib first.mtl\nmtllib my part.mtl\nusemtl paint"
    )
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-8-sig", "utf-16"])
def test_text_in_any_encoding(tmp_path: Path, encoding: str) -> None:
    path = write_obj(tmp_path / "part.obj", lines="mtllib größe.mtl\nusemtl Stoß")
    path.write_bytes(("# für Jörg\n" + path.read_text("latin-1")).encode(encoding))
    text = "# Übung\nnewmtl Stoß\nKd 0.784 0.157 0.157\n"
    (tmp_path / "größe.mtl").write_bytes(text.encode(encoding))
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


@pytest.mark.parametrize("vertex", ["0.784 0.157 0.157", "200 40 40", "200.0 40.0 40.0 255"])
@pytest.mark.parametrize("material", ["", "Kd 0 0 1"])
def test_vertex_colors(tmp_path: Path, vertex: str, material: str) -> None:
    (tmp_path / "part.mtl").write_text(f"newmtl paint\n{material}\n")
    path = write_obj(tmp_path / "part.obj", vertex, MATERIAL if material else "")
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


@pytest.mark.parametrize("color", ["0.784 0.157 0.157", "200 40 40"])
def test_white_vertices_do_not_hide_the_material(tmp_path: Path, color: str) -> None:
    (tmp_path / "part.mtl").write_text(f"newmtl paint\nKd {color}\n")
    path = write_obj(tmp_path / "part.obj", "1 1 1", MATERIAL)
    np.testing.assert_allclose(colors_of(path), [RED] * 4, atol=0.5)


def test_some_colored_vertices_are_refused(tmp_path: Path) -> None:
    path = write_obj(tmp_path / "part.obj", "200 40 40")
    path.write_text(path.read_text() + "v 1 1 1\n")
    with pytest.raises(ValueError, match="for some of its vertices only"):
        read_parts(path)


def test_vertices_of_two_numbers_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "part.obj"
    path.write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    with pytest.raises(ValueError, match=r"part\.obj"):
        read_parts(path)
