"""Small mesh files with known colors, and what is read from them."""

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from two_view_pose.assets.mesh_files import read_parts

CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype=np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint16)
"""A tetrahedron."""

RED = (200, 40, 40)


def colors_of(path: Path) -> np.ndarray:
    """sRGB colors 0 to 255 (F, 3) in the middle of all faces."""
    found = []
    for part in read_parts(path):
        face = np.arange(len(part.mesh.faces))
        found.append(part.paint.rgb(part.mesh.faces, face, np.full((len(face), 3), 1 / 3)))
    return 255 * np.concatenate(found)


def png(rgba: Any, mode: str | None = None) -> bytes:
    """A PNG of these pixels (H, W, C), or of one color."""
    pixels = np.asarray(rgba, dtype=np.uint8)
    stream = io.BytesIO()
    image = Image.fromarray(np.tile(pixels, (4, 4, 1)) if pixels.ndim == 1 else pixels)
    (image if mode is None else image.convert(mode)).save(stream, "PNG")
    return stream.getvalue()


def write_obj(path: Path, vertex: str = "", lines: str = "", faces: str = "f {0}/{0} {1}/{1} {2}/{2}") -> Path:  # fmt: skip # noqa: E501
    """The tetrahedron as OBJ: ``vertex`` follows each position, ``lines`` come before the faces."""
    text = "".join(f"v {x} {y} {z} {vertex}\n" for x, y, z in CORNERS)
    text += "vt 0.1 0.1\nvt 0.9 0.1\nvt 0.1 0.9\nvt 0.9 0.9\n" + lines + "\n"
    text += "".join(faces.format(*face) + "\n" for face in FACES + 1)
    path.write_bytes(text.encode("latin-1"))
    return path


def write_ply(
    path: Path,
    vertex: tuple[str, ...] = (),
    values: str = "",
    face: tuple[str, ...] = (),
    face_values: str = "",
    comment: str = "",
) -> Path:
    """The tetrahedron as ASCII PLY with further properties, each of them "type name"."""
    lines = ["ply", "format ascii 1.0", *([comment] if comment else []), "element vertex 4"]
    lines += [f"property {p}" for p in ("float x", "float y", "float z", *vertex)]
    lines += ["element face 4", "property list uchar int vertex_indices"]
    lines += [*(f"property {p}" for p in face), "end_header"]
    lines += [f"{x} {y} {z} {values}" for x, y, z in CORNERS]
    lines += [f"3 {a} {b} {c} {face_values}" for a, b, c in FACES]
    path.write_bytes("\n".join([*lines, ""]).encode("latin-1"))
    return path


def write_glb(
    path: Path,
    material: dict[str, Any] | None = None,
    attributes: dict[str, np.ndarray] | None = None,
    images: tuple[bytes | dict[str, Any], ...] = (),
    position: np.ndarray = CORNERS,
    **header: Any,
) -> Path:
    """The tetrahedron as GLB; integers in ``attributes`` are normalized."""
    types = {"f4": 5126, "u1": 5121, "u2": 5123, "i2": 5122}
    arrays = {"POSITION": position, **(attributes or {}), "indices": FACES.reshape(-1, 1)}
    views, accessors, blob = [], [], b""
    for name, array in arrays.items():
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[array.shape[1]]
        entry = {"bufferView": len(views), "componentType": types[array.dtype.str[1:]]}
        accessors.append(entry | {"count": len(array), "type": kind})
        if array.dtype.kind != "f" and name != "indices":
            accessors[-1]["normalized"] = True
        data = array.tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        blob += data + b"\0" * (-len(data) % 4)
    entries = []
    for image in images:
        if isinstance(image, bytes):
            views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(image)})
            blob += image + b"\0" * (-len(image) % 4)
            image = {"bufferView": len(views) - 1, "mimeType": "image/png"}
        entries.append(image)
    names = [*arrays][:-1]
    primitive = {"attributes": {n: i for i, n in enumerate(names)}, "indices": len(names)}
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive | ({} if material is None else {"material": 0})]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    if material is not None:
        document["materials"] = [material]
    if entries:
        document |= {"images": entries, "textures": [{"source": i} for i in range(len(entries))]}
    text = json.dumps(document | header).encode()
    text += b" " * (-len(text) % 4)
    start = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob))
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0")
    )
    path.write_bytes(start + chunks + blob)
    return path
