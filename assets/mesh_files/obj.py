"""OBJ files: trimesh parses the geometry, colors and materials are read here."""

import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.obj import load_obj
from trimesh.resolvers import ZipResolver

from ...core.errors import InputError
from .linked_files import decode_text, find_linked, read_texture, require_linked
from .mtl import MtlMaterial, read_mtl
from .paint import DEFAULT_COLOR, Paint, all_white, plain_paint, unit_range, unpainted
from .part import Part

_COLORED_VERTEX = re.compile(r"^v(?:[ \t]+\S+){6}", re.MULTILINE)


def read_obj(path: Path, colors: bool) -> list[Part]:
    """Reads an OBJ file with the material libraries that it names.

    A texture goes before colors of vertices, these before a material's color; colors of vertices
    that are all white say nothing.
    """
    text = decode_text(path.read_bytes()).replace("\r\n", "\n").replace("\\\n", " ")
    libraries = re.findall(r"^[ \t]*mtllib[ \t]+(.*?)[ \t]*$", text, re.MULTILINE)
    # trimesh reads one library, and drops the names of materials that are not in it: it gets
    # numbers for names, all of them known.
    used: dict[str, int] = {}
    text = re.sub(
        r"^[ \t]*usemtl\b[ \t]*(.*?)[ \t]*$",
        lambda match: f"usemtl {used.setdefault(match[1], len(used))}",
        text,
        flags=re.MULTILINE,
    )
    text = re.sub(r"^[ \t]*mtllib\b.*$|#.*$|^[ \t]+", "", text, flags=re.MULTILINE)
    known = ZipResolver({"all": BytesIO("".join(f"newmtl {i}\n" for i in used.values()).encode())})
    loaded = load_obj(BytesIO(f"mtllib all\n{text}".encode()), resolver=known)
    pieces = list(loaded.get("geometry", {}).values())
    meshes = [trimesh.Trimesh(p["vertices"], p["faces"], process=False) for p in pieces]
    if not colors:
        return [Part(mesh, Paint()) for mesh in meshes]
    paint = _painter(path, libraries, list(used), _vertex_colors(pieces, text, path))
    return [Part(m, paint(i, p)) for i, (m, p) in enumerate(zip(meshes, pieces, strict=True))]


def _vertex_colors(pieces: list[dict], text: str, path: Path) -> list[np.ndarray | None]:
    """Colors of each piece's vertices, in one range for the whole file."""
    found = [p["vertex_colors"] for p in pieces if p.get("vertex_colors") is not None]
    if len(found) < len(pieces):
        if _COLORED_VERTEX.search(text):
            raise InputError(f"{path} has colors (v x y z r g b) for some of its vertices only")
        return [None] * len(pieces)
    if not found:
        return []
    rgba = unit_range(np.concatenate(found), str(path))
    if all_white(rgba):
        return [None] * len(pieces)
    return [*np.split(rgba, np.cumsum([len(colors) for colors in found])[:-1])]


def _painter(
    path: Path, libraries: list[str], used: list[str], vertex_colors: list[np.ndarray | None]
) -> Callable[[int, dict], Paint]:
    """Returns what paints piece number i, as trimesh read it."""
    materials = _read_libraries(path, libraries)
    textures: dict[str, np.ndarray] = {}

    def material_of(piece: dict) -> MtlMaterial | None:
        name = getattr(getattr(piece["visual"], "material", None), "name", "")
        if not name.isdigit():  # faces before the first usemtl
            return materials[0] if len(materials) == 1 else None
        return _named(used[int(name)], materials) if libraries else None

    def paint(i: int, piece: dict) -> Paint:
        material = material_of(piece)
        if material is not None and material.texture is not None:
            return _textured(path, material, piece["visual"], textures)
        if vertex_colors[i] is not None:
            return Paint(colors=vertex_colors[i], kind="colors of the vertices", source=str(path))
        if material is None:
            return unpainted(str(path))
        color = DEFAULT_COLOR if material.color is None else material.color
        return plain_paint(color, "materials", str(path))

    def _named(name: str, materials: list[MtlMaterial]) -> MtlMaterial:
        for key in (str, str.casefold):
            for material in materials:
                if key(material.name) == key(name):
                    return material
        raise InputError(
            f"{path} uses the material {name!r}, which {', '.join(libraries)} does not have: it "
            f"has {', '.join(m.name for m in materials) or 'none'}"
        )

    return paint


def _read_libraries(path: Path, libraries: list[str]) -> list[MtlMaterial]:
    materials: list[MtlMaterial] = []
    for names in dict.fromkeys(libraries):
        # One name with spaces, or several names.
        several = [names] if find_linked(names, path) else names.split()
        if not all(find_linked(name, path) for name in several):
            several = [names]
        for name in several:
            remedy = "remove its line mtllib for an object without colors"
            materials += read_mtl(require_linked(name, path, "material file", remedy))
    return materials


def _textured(
    path: Path, material: MtlMaterial, visual: object, textures: dict[str, np.ndarray]
) -> Paint:
    """The paint of a material with a texture; its Kd is ignored, as viewers do."""
    assert material.texture is not None
    source = f"{path}, material {material.name!r}"
    uv = getattr(visual, "uv", None)
    if uv is None:
        raise InputError(
            f"{source} has the texture {material.texture!r}, but not all of its faces have texture "
            "coordinates (vt)"
        )
    if material.texture not in textures:
        remedy = f"remove map_Kd from the material {material.name!r} for its plain color"
        file = require_linked(material.texture, path, "texture", remedy)
        textures[material.texture] = read_texture(file, f"{file}, the texture of {path},")
    return Paint(
        texture=textures[material.texture],
        uv=np.asarray(uv)[:, :2] * material.scale + material.offset,
        wrap=("clamp", "clamp") if material.clamp else ("repeat", "repeat"),
        kind="texture",
        source=source,
    )
