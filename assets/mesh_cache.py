"""Imported meshes kept on the disk: what took a second or two is read back in milliseconds.

An entry's name is the digest of all that its content depends on: the mesh file's bytes, the options
of the import, the version of its code and the libraries that do it. So nothing ever goes out of
date, and an entry that is read back is the imported object to the bit. The folder is
``$XDG_CACHE_HOME/two_view_pose/meshes`` (``~/.cache`` where that is not set); it may be deleted at
any time, and where it cannot be written or read, meshes are imported every time.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import zipfile
from collections.abc import Callable
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ..core.files import write_atomically
from .object_model import ObjectModel

_LIBRARIES = ("fast-simplification", "networkx", "numpy", "pillow", "scipy", "trimesh", "xatlas")

_POINTERS = (b"mtllib", b"TextureFile", b'"uri"')
"""What stands in an OBJ, a PLY or a GLB file that takes its colors from other files."""


def cached(key: str | None, make: Callable[[], ObjectModel]) -> ObjectModel:
    """The object that is kept under ``key``, else ``make()``, which is then kept.

    Args:
        key: from `mesh_key`; None keeps nothing.
        make: imports the object; what it raises is raised.
    """
    folder = cache_folder() if key is not None else None
    if folder is None:
        return make()
    path = folder / f"{key}.npz"
    # An entry that is missing, cut off or no entry at all is simply replaced.
    with contextlib.suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return _unpack(path.read_bytes())
    model = make()
    with contextlib.suppress(OSError):
        write_atomically(path, _pack(model))
    return model


def mesh_key(path: Path, options: object) -> str | None:
    """The digest of all that the import of a mesh depends on; None if that cannot be told.

    Args:
        path: the mesh file. One that refers to other files (materials, textures) has no key.
        options: of the import, and the version of its code; their ``repr`` counts.

    Raises:
        OSError: if a file cannot be read.
    """
    content = path.read_bytes()
    if any(pointer in content for pointer in _POINTERS):
        return None
    libraries = [(name, version(name)) for name in _LIBRARIES]
    digest = hashlib.sha256(repr((path.name, options, libraries)).encode())
    digest.update(content)
    return digest.hexdigest()


def cache_folder() -> Path | None:
    """Where entries lie; None where the user has no home. It need not exist."""
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
    """The object that `_pack` wrote; arrays keep their types and every bit.

    Raises:
        InputError: or KeyError, EOFError, zipfile.BadZipFile, if it is no such thing.
    """
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        values = {field.name: arrays[field.name] for field in fields(ObjectModel)}
    # Numbers and text come back as arrays without axes.
    return ObjectModel(**{k: v if v.ndim else v.item() for k, v in values.items()})
