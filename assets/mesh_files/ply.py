"""PLY files: trimesh parses the elements, colors and the texture are read here."""

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.exchange.ply import load_ply

from ...core.errors import InputError
from .linked_files import decode_text, read_texture, require_linked
from .paint import Paint, all_white, unit_range, unpainted
from .part import Part

_CHANNELS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green",
    "diffuse_blue"))  # fmt: skip
"""Names of the properties of a color, compared in lower case."""

_END = re.compile(rb"end_header[ \t]*\r?\n")
_TEXTURE = re.compile(r"^(?:comment|obj_info)[ \t]+TextureFile[ \t]+(.*?)[ \t\r]*$", re.I | re.M)


def read_ply(path: Path, colors: bool) -> list[Part]:
    """Reads a PLY file with its texture.

    A texture goes before colors of vertices, these before colors of faces; colors that are all
    white say nothing.
    """
    stream, header = open_ply(path)
    textures = _TEXTURE.findall(header) if colors else []
    if len(set(textures)) > 1:
        raise InputError(f"{path} has {len(textures)} textures: join them to one")
    # Vertices are doubled at texture seams where the texture is used, only there.
    try:
        with np.errstate(invalid="raise"):  # of casts to integers
            loaded = load_ply(stream, fix_texture=bool(textures), skip_materials=True)
    except FloatingPointError as error:
        raise InputError(f"{path} has NaN, infinite or too large numbers") from error
    if "vertices" not in loaded or loaded.get("faces") is None:
        return []
    mesh = trimesh.Trimesh(loaded["vertices"], loaded["faces"], process=False)
    if not colors:
        return [Part(mesh, Paint())]
    if textures:
        return [Part(mesh, _textured(path, textures[0], loaded))]
    return [Part(mesh, _colored(path, loaded, mesh))]


def open_ply(path: Path) -> tuple[BytesIO, str]:
    """Returns a file that trimesh can read, and its header: comments may be in Latin-1."""
    data = path.read_bytes()
    end = _END.search(data)
    if end is None:
        raise InputError(
            f"{path} cannot be read as a mesh: no PLY file, or truncated (no end_header)"
        )
    header = decode_text(data[: end.end()])
    return BytesIO(header.encode() + data[end.end() :]), header


def _textured(path: Path, name: str, loaded: dict[str, Any]) -> Paint:
    uv = getattr(loaded.get("visual"), "uv", None)
    if uv is None:
        raise InputError(
            f"{path} has the texture {name!r}, but no texture coordinates (texture_u, texture_v)"
        )
    remedy = "remove its line 'comment TextureFile' for the colors of the vertices"
    file = require_linked(name, path, "texture", remedy)
    texture = read_texture(file, f"{file}, the texture of {path},")
    return Paint(texture=texture, uv=np.asarray(uv)[:, :2], kind="texture", source=str(path))


def _colored(path: Path, loaded: dict[str, Any], mesh: trimesh.Trimesh) -> Paint:
    """Colors of vertices or faces."""
    elements = loaded["metadata"]["_ply_raw"]
    white = None
    for element, count in (("vertex", len(mesh.vertices)), ("face", len(mesh.faces))):
        values = _element_colors(elements.get(element, {}))
        if values is None:
            continue
        if len(values) != count:  # polygons were cut to triangles
            raise InputError(
                f"{path} has colors of faces that are not triangles: triangulate it, or color its "
                "vertices"
            )
        rgba = unit_range(values, str(path))
        kind = "colors of the vertices" if element == "vertex" else "colors of the faces"
        paint = Paint(colors=rgba, of_faces=element == "face", kind=kind, source=str(path))
        if not all_white(rgba):
            return paint
        white = white or paint
    return white or unpainted(str(path))


def _element_colors(element: dict[str, Any]) -> np.ndarray | None:
    """Columns red, green and blue (N, 3) as stored; None if the element has none."""
    names = {name.lower(): name for name in element.get("properties", {})}
    for channels in _CHANNELS:
        if all(channel in names for channel in channels) and "data" in element:
            columns = [np.asarray(element["data"][names[channel]]) for channel in channels]
            return np.stack([column.reshape(-1) for column in columns], axis=1)
    return None
