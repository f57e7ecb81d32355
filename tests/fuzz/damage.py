"""Damages one file: as the format that it has, as text, or as bytes."""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .byte_damage import damage_bytes
from .json_damage import damage_json
from .text_damage import damage_text

Change = Callable[[bytes, np.random.Generator], bytes]


def damage(path: Path, rng: np.random.Generator) -> None:
    """Changes a file in a way that fits its type."""
    content = path.read_bytes()
    changes = CHANGES.get(path.suffix, (damage_text, damage_bytes))
    # The first way is the one that comes farthest into a reader.
    weights = np.array([4.0, *[1.0] * (len(changes) - 1)])
    change = changes[rng.choice(len(changes), p=weights / weights.sum())]
    path.unlink()  # it may be a link
    path.write_bytes(change(content, rng))


def _json_lines(content: bytes, rng: np.random.Generator) -> bytes:
    lines = content.splitlines()
    at = int(rng.integers(len(lines)))
    lines[at] = damage_json(lines[at], rng)
    return b"\n".join([*lines, b""])


def _safetensors_header(content: bytes, rng: np.random.Generator) -> bytes:
    """Damages the JSON, or the JSON within its metadata."""
    (size,) = struct.unpack("<Q", content[:8])
    text = content[8 : 8 + size]
    document = json.loads(text)
    metadata = document.get("__metadata__", {})
    if metadata and rng.random() < 0.6:
        key = sorted(metadata)[int(rng.integers(len(metadata)))]
        inner = damage_json(metadata[key].encode(), rng)
        metadata[key] = inner.decode("utf-8", "replace")
        text = json.dumps(document).encode()
    else:
        text = damage_json(text, rng)
    return struct.pack("<Q", len(text)) + text + content[8 + size :]


def _glb_document(content: bytes, rng: np.random.Generator) -> bytes:
    (size,) = struct.unpack("<I", content[12:16])
    text = damage_json(content[20 : 20 + size], rng)
    text += b" " * (-len(text) % 4)
    rest = content[20 + size :]
    start = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return start + struct.pack("<I4s", len(text), b"JSON") + text + rest


def _npz_arrays(content: bytes, rng: np.random.Generator) -> bytes:
    """Damages one array, or the JSON that one of them holds."""
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    name = sorted(arrays)[int(rng.integers(len(arrays)))]
    if "header" in arrays and rng.random() < 0.5:
        header = damage_json(bytes(arrays["header"]), rng)
        arrays["header"] = np.frombuffer(header, np.uint8)
    elif rng.random() < 0.2:
        del arrays[name]
    else:
        arrays[name] = damage_array(arrays[name], rng)
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def _npy_array(content: bytes, rng: np.random.Generator) -> bytes:
    stream = io.BytesIO()
    np.save(stream, damage_array(np.load(io.BytesIO(content)), rng))
    return stream.getvalue()


def damage_array(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Changes an array's type, shape or numbers."""
    flat = array.ravel()
    kind = int(rng.integers(7))
    if kind == 0 and array.dtype.kind in "fiub":
        with np.errstate(all="ignore"):
            kinds = ["float64", "int8", "bool", "complex64", "U4", "float16"]
            return array.astype(rng.choice(kinds))
    if kind == 1:
        return flat[: int(rng.integers(flat.size + 1))]
    if kind == 2:
        return array[..., None] if rng.random() < 0.5 else array[None]
    if kind == 3:
        return np.empty((0, *array.shape[1:]), array.dtype)
    if kind == 4:
        return array.T
    if array.dtype.kind != "f" or not array.size:
        return array[::-1] if array.ndim else array[None]
    changed = array.copy()
    numbers = [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e30]
    changed.flat[int(rng.integers(array.size))] = rng.choice(numbers)
    return changed


def _png_chunk(content: bytes, rng: np.random.Generator) -> bytes:
    """Damages the data of one chunk of a PNG, whose checksum is made right again."""
    start, chunks = 8, []
    while start < len(content):
        (size,) = struct.unpack(">I", content[start : start + 4])
        chunks.append((content[start + 4 : start + 8], content[start + 8 : start + 8 + size]))
        start += 12 + size
    at = int(rng.integers(len(chunks)))
    kind, data = chunks[at]
    if kind == b"IDAT" and rng.random() < 0.7:
        data = zlib.compress(damage_bytes(zlib.decompress(data), rng))
    elif data:
        data = damage_bytes(data, rng)
    chunks[at] = (kind, data)
    if rng.random() < 0.1:
        chunks.append(chunks.pop(at))
    return content[:8] + b"".join(
        struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks
    )


CHANGES: dict[str, tuple[Change, ...]] = {
    ".json": (damage_json, damage_text, damage_bytes),
    ".jsonl": (_json_lines, damage_text, damage_bytes),
    ".safetensors": (_safetensors_header, damage_bytes),
    ".glb": (_glb_document, damage_bytes),
    ".npz": (_npz_arrays, damage_bytes),
    ".npy": (_npy_array, damage_bytes),
    ".png": (_png_chunk, damage_bytes),
    ".jpg": (damage_bytes,),
    ".tif": (damage_bytes,),
    ".stl": (damage_bytes, damage_text),
}
"""Suffix -> ways of damage; other files are text."""
