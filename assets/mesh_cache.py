"""Disk cache of imported meshes: reading takes milliseconds, an import a second or two.

The key is the digest of everything that the import depends on: the mesh file's bytes, the options,
and the versions of our code and its libraries. Entries are bit-exact. The folder is
``$XDG_CACHE_HOME/two_view_pose/meshes`` (default ``~/.cache``); it can be deleted at any time, and
without access to it every import runs.
"""

import contextlib
import hashlib
import io
import os
from collections.abc import Callable
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ..core.files import write_atomically
from .object_model import ObjectModel

_LIBRARIES = ("fast-simplification", "networkx", "numpy", "pillow", "scipy", "trimesh", "xatlas")

_POINTERS = (b"mtllib", b"TextureFile", b'"uri"')
"""Bytes in OBJ, PLY and GLB files that refer to other files for colors."""


def cached(key: str | None, make: Callable[[], ObjectModel]) -> ObjectModel:
    """Returns the entry of ``key`` (from `mesh_key`; None: no cache), else stores ``make()``."""
    folder = cache_folder() if key is not None else None
    if folder is None:
        return make()
    path = folder / f"{key}.npz"
    # Missing and corrupted entries are replaced: NumPy and zipfile raise all kinds of errors.
    with contextlib.suppress(Exception):
        return _unpack(path.read_bytes())
    model = make()
    with contextlib.suppress(OSError):
        write_atomically(path, _pack(model))
    return model


def mesh_key(path: Path, options: object) -> str | None:
    """The key of an import; None if the mesh refers to other files (materials, textures).

    Args:
        path: the mesh file.
        options: of the import, and the version of its code; must have a stable ``repr``.
    """
    content = path.read_bytes()
    if any(pointer in content for pointer in _POINTERS):
        return None
    libraries = [(name, version(name)) for name in _LIBRARIES]
    digest = hashlib.sha256(repr((path.name, options, libraries)).encode())
    digest.update(content)
    return digest.hexdigest()


def cache_folder() -> Path | None:
    """The folder of the entries, which may not exist; None without a home directory."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(named):  # the specification says to ignore others
        return Path(named) / "two_view_pose" / "meshes"
    try:
        return Path.home() / ".cache" / "two_view_pose" / "meshes"
    except RuntimeError:
        return None


def _pack(model: ObjectModel) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **{field.name: getattr(model, field.name) for field in fields(model)})
    return stream.getvalue()


def _unpack(content: bytes) -> ObjectModel:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        values = {field.name: arrays[field.name] for field in fields(ObjectModel)}
    # Numbers and text are read as arrays of shape ().
    return ObjectModel(**{k: v if v.ndim else v.item() for k, v in values.items()})
