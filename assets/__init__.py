"""Objects: thirteen that ship, with LineMOD's names and sizes, and users' meshes.

``object_model`` is what the other rooms know about an object; ``storage`` its files;
``mesh_files`` reads every format and every way of coloring; ``mesh_import`` makes an object of it
with ``surface``, ``surface_colors``, ``texture`` and ``mesh_cache``; ``collage`` draws random
textures. ``objects``, ``weights`` and ``agents`` are data.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path

from ..core.errors import InputError
from .object_model import ObjectModel
from .storage import read_object

__all__ = ["OBJECT_NAMES", "ObjectModel", "load_object", "load_objects", "split_name"]

_LINEMOD = "ape benchvise cam can cat driller duck eggbox glue holepuncher iron lamp phone"

OBJECT_NAMES: tuple[str, ...] = tuple(_LINEMOD.split())
"""The thirteen objects that ship, in LineMOD's order."""

_FOLDER = Path(__file__).parent / "objects"


def load_object(name_or_path: str | Path, unit: str = "auto") -> ObjectModel:
    """Loads an object, cached.

    Args:
        name_or_path: one of ``OBJECT_NAMES``, a mesh file (PLY, OBJ, STL, GLB) or the folder of a
            built object (model.glb and object.json). "NAME=PATH" sets the name.
        unit: of a mesh file, see ``core.units``.

    Raises:
        InputError: if it is neither a known name nor a path, or the file is not a usable mesh.
        FileNotFoundError: if the path does not exist.
    """
    if str(name_or_path) in OBJECT_NAMES:
        return _load_shipped(str(name_or_path))
    name, path = split_name(name_or_path)
    if name is None and not path.exists() and not path.suffix and path.name == str(name_or_path):
        raise InputError(
            f"unknown object {name_or_path!r}: it must be one of {', '.join(OBJECT_NAMES)}, "
            "or the path of a mesh file (.ply, .obj, .stl, .glb)"
        )
    if (path / "object.json").is_file():
        model = read_object(path)
        return model if name is None else replace(model, name=name)
    from .mesh_import import import_mesh

    return import_mesh(path, name, unit=unit)


def split_name(name_or_path: str | Path) -> tuple[str | None, Path]:
    """Splits "NAME=PATH"; the name is None without one, or if the path itself has an "="."""
    name, equals, path = str(name_or_path).partition("=")
    if equals and name.isidentifier() and not Path(name_or_path).exists():
        return name, Path(path)
    return None, Path(name_or_path)


def load_objects(
    spec: str | Path | Iterable[str | Path] | None = None,
    load: Callable[[str | Path], ObjectModel] = load_object,
) -> dict[str, ObjectModel]:
    """Loads several objects by name.

    Args:
        spec: names and paths, one of them, a folder of meshes, or None for the thirteen.
        load: loads one object.

    Raises:
        InputError: if two objects have the same name, ``spec`` is empty, or as `load_object`.
        FileNotFoundError: as `load_object`.
    """
    if spec is None:
        spec = OBJECT_NAMES
    items = [spec] if isinstance(spec, str | Path) else list(spec)
    models: dict[str, ObjectModel] = {}
    for item in items:
        for part in _expand(item):
            model = load(part)
            if model.name in models:
                raise InputError(f"two objects have the name {model.name!r}; rename a file")
            models[model.name] = model
    if not models:
        raise InputError("objects is empty: name at least one object or mesh file")
    return models


def _expand(item: str | Path) -> list[str | Path]:
    """Expands a folder of meshes to its files."""
    path = Path(item)
    if str(item) in OBJECT_NAMES or not path.is_dir() or (path / "object.json").is_file():
        return [item]
    from .mesh_files import MESH_SUFFIXES

    built = sorted(folder.parent for folder in path.glob("*/object.json"))
    meshes = sorted(file for file in path.iterdir() if file.suffix.lower() in MESH_SUFFIXES)
    if not built and not meshes:
        raise InputError(f"{path} has no mesh files ({', '.join(MESH_SUFFIXES)})")
    return [*built, *meshes]


@cache
def _load_shipped(name: str) -> ObjectModel:
    """Loads one of the thirteen, once per process."""
    return read_object(_FOLDER / name)
