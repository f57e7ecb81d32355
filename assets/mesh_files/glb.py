"""GLB files: trimesh parses the geometry and its placement, ``gltf_paint`` the colors.

Khronos Group, "glTF 2.0 Specification".
"""

import json
import struct
from base64 import b64decode, b64encode
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ...core.errors import InputError
from .gltf_paint import GltfPainter
from .linked_files import require_linked
from .paint import Paint
from .part import Part

_UNDERSTOOD = {
    "EXT_texture_avif",
    "EXT_texture_webp",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    # of light sources and of shine, which the rendering sets itself
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_specular",
}

_LARGEST = {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}
"""What means 1 in normalized integers, by their componentType."""

_JSON, _TRIANGLES, _STRIP, _FAN = 0x4E4F534A, 4, 5, 6


def read_glb(path: Path, colors: bool) -> list[Part]:
    """Reads all triangles of a GLB file's scene.

    Raises:
        InputError: if it needs an extension, or holds data, that is not understood.
    """
    header, binary = _read_chunks(path)
    if unknown := sorted(set(header.get("extensionsRequired", [])) - _UNDERSTOOD):
        raise InputError(
            f"{path} needs the glTF extension {', '.join(unknown)}, which is not supported: export "
            "it without (no compression, plain PNG or JPEG textures)"
        )
    buffers = _Buffers(path, header, binary)
    primitives = _flatten(header, path)
    data = _pack(header | {"buffers": buffers.embedded()}, binary)
    scene = trimesh.load_scene(BytesIO(data), file_type="glb", process=False, skip_materials=True)
    painter = GltfPainter(path, header, buffers.view)
    parts = []
    for node in scene.graph.nodes_geometry:
        T, name = scene.graph[node]
        mesh, primitive = scene.geometry[name], primitives[int(str(name))]
        attributes = {
            key.removeprefix("_"): _normalized(values, header, primitive["attributes"][key])
            for key, values in mesh.vertex_attributes.items()
        }
        position = primitive["attributes"]["POSITION"]
        vertices = _normalized(np.asarray(mesh.vertices), header, position)
        placed = trimesh.Trimesh(vertices, mesh.faces, process=False).apply_transform(T)
        paint = painter.paint(primitive["material"], attributes) if colors else Paint()
        parts.append(Part(placed, paint))
    return parts


def _read_chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON chunk, and the rest of the file."""
    data = path.read_bytes()
    if len(data) < 20 or data[:4] != b"glTF":
        raise InputError(f"{path} cannot be read as a mesh: no GLB file, or truncated")
    version, length, size, kind = struct.unpack("<IIII", data[4:20])
    if version != 2:
        raise InputError(f"{path} is glTF version {version}; only 2 is supported")
    if kind != _JSON or length > len(data):
        raise InputError(f"{path} cannot be read as a mesh: no GLB file, or truncated")
    return json.loads(data[20 : 20 + size]), data[20 + size : length]


def _pack(header: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    start = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(binary), len(text), _JSON)
    return start + text + binary


class _Buffers:
    """The bytes of a file's buffers, also of those in other files."""

    def __init__(self, path: Path, header: dict[str, Any], binary: bytes):
        self._path, self._views = path, header.get("bufferViews", [])
        self._buffers = header.get("buffers", [])
        self._binary = binary[8 : 8 + struct.unpack("<I", binary[:4])[0]] if binary else b""

    def view(self, source: dict[str, Any], what: str) -> bytes | Path:
        """The content of an object with ``bufferView`` or ``uri``: bytes, or a file."""
        if "bufferView" in source:
            view = self._views[source["bufferView"]]
            start = view.get("byteOffset", 0)
            return self._content(view["buffer"])[start : start + view["byteLength"]]
        uri = source["uri"]
        if uri.startswith("data:"):
            return b64decode(uri.partition("base64,")[2])
        return require_linked(uri, self._path, what, "export the GLB with everything inside")

    def embedded(self) -> list[dict[str, Any]]:
        """The buffers with other files' content as base64."""
        found = []
        for i, buffer in enumerate(self._buffers):
            if "uri" in buffer:
                text = b64encode(self._content(i)).decode()
                buffer = buffer | {"uri": f"data:application/octet-stream;base64,{text}"}
            found.append(buffer)
        return found

    def _content(self, index: int) -> bytes:
        if "uri" not in self._buffers[index]:
            return self._binary
        content = self.view(self._buffers[index], "buffer")
        return content.read_bytes() if isinstance(content, Path) else content


def _flatten(header: dict[str, Any], path: Path) -> list[dict[str, Any]]:
    """Makes every primitive a mesh of its own, named by its number; returns them.

    Thereby trimesh's meshes can be told apart, and give all attributes as they are stored.
    """
    primitives: list[dict[str, Any]] = []
    numbers: list[list[int]] = []
    for mesh in header.get("meshes", []):
        numbers.append([])
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", _TRIANGLES)
            if mode < _TRIANGLES:
                continue  # points and lines are no surface
            _check_primitive(primitive, header, path)
            numbers[-1].append(len(primitives))
            attributes = {
                key if key == "POSITION" else f"_{key}": index
                for key, index in primitive["attributes"].items()
                if key == "POSITION" or key.startswith(("TEXCOORD_", "COLOR_0"))
            }
            kept = {key: primitive[key] for key in ("indices", "mode") if key in primitive}
            kept |= {"attributes": attributes, "material": primitive.get("material")}
            primitives.append(kept)
    nodes = header.get("nodes", [])
    for node in list(nodes):
        node.pop("camera", None)
        if "mesh" in node:
            first, *others = numbers[node.pop("mesh")] or [None]
            if first is not None:
                node["mesh"] = first
            node["children"] = [*node.get("children", []), *_added(nodes, others)]
            if not node["children"]:
                del node["children"]
    header["meshes"] = [
        {"name": str(i), "primitives": [{k: v for k, v in p.items() if k != "material"}]}
        for i, p in enumerate(primitives)
    ]
    return primitives


def _added(nodes: list[dict[str, Any]], meshes: list[Any]) -> list[int]:
    """Appends a node for each mesh; returns the nodes' numbers."""
    nodes += [{"mesh": mesh} for mesh in meshes]
    return list(range(len(nodes) - len(meshes), len(nodes)))


def _check_primitive(primitive: dict[str, Any], header: dict[str, Any], path: Path) -> None:
    if primitive.get("mode", _TRIANGLES) not in (_TRIANGLES, _STRIP):
        raise InputError(f"{path} has triangle fans, which are not supported: export triangles")
    accessors = header["accessors"]
    used = [*primitive["attributes"].values(), *([primitive["indices"]] if "indices" in primitive
        else [])]  # fmt: skip
    if any("sparse" in accessors[i] for i in used):
        raise InputError(f"{path} has sparse accessors, which are not supported: export it without")
    if any("bufferView" not in accessors[i] for i in used):
        named = ", ".join(primitive.get("extensions", {})) or "no extension"
        raise InputError(f"{path} has compressed geometry ({named}): export it without compression")


def _normalized(values: np.ndarray, header: dict[str, Any], accessor: int) -> np.ndarray:
    """Stored integers as numbers: those of a normalized accessor are 0 to 1 or -1 to 1."""
    numbers = np.asarray(values, dtype=np.float64)
    stored = header["accessors"][accessor]
    if stored.get("normalized") and stored["componentType"] in _LARGEST:
        return np.maximum(numbers / _LARGEST[stored["componentType"]], -1.0)
    return numbers
