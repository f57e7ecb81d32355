"""Files of an object: ``model.glb``, which mesh viewers open, and ``object.json``.

An object whose mesh may not be redistributed is ``object.json`` only, with its bounding box.
"""

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from ..core.errors import InputError
from ..core.files import write_atomically
from ..core.geometry import check_rigid
from ..core.images import to_rgb
from ..core.text_files import read_text
from ..core.validation import is_number
from .object_model import ObjectModel

FORMAT_VERSION = 1
MESH_FILE = "model.glb"
NUMBERS_FILE = "object.json"

_ARRAYS = ("keypoints", "symmetries", "stable_poses", "points")
_WITHOUT_SURFACE = ("keypoints", "symmetries")
_SCALARS = ("name", "obj_id", "diameter", "specular", "shininess")


def save_object(model: ObjectModel, folder: str | Path, *, surface: bool = True) -> None:
    """Writes an object with reproducible bytes.

    The mesh is stored in the object's own frame, z up, in meters and single precision; the
    texture is a PNG inside the GLB.

    Args:
        model: the object.
        folder: created if it does not exist.
        surface: False stores only keypoints, symmetries, diameter and bounding box.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    numbers: dict[str, object] = {"format": FORMAT_VERSION}
    numbers |= {key: getattr(model, key) for key in _SCALARS}
    libraries = ("numpy", "trimesh", "xatlas") if surface else ("numpy",)
    numbers["made_with"] = {name: version(name) for name in libraries}
    if surface:
        write_atomically(folder / MESH_FILE, _glb(model))
    else:
        numbers["box"] = [model.vertices.min(axis=0).tolist(), model.vertices.max(axis=0).tolist()]
    arrays = _ARRAYS if surface else _WITHOUT_SURFACE
    numbers |= {key: getattr(model, key).tolist() for key in arrays}
    text = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in numbers.items())
    write_atomically(folder / NUMBERS_FILE, f"{{\n{text}\n}}\n".encode())


def _glb(model: ObjectModel) -> bytes:
    """The textured mesh as a GLB file."""
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(model.texture),
        metallicFactor=0.0,
        roughnessFactor=float(np.clip(1.0 - model.shininess, 0.0, 1.0)),
    )
    mesh = trimesh.Trimesh(
        model.vertices,
        model.faces,
        visual=trimesh.visual.TextureVisuals(uv=model.uv, material=material),
        process=False,
    )
    scene = trimesh.Scene()
    scene.add_geometry(mesh, geom_name=model.name)
    return trimesh.exchange.gltf.export_glb(scene)


def read_object(folder: str | Path) -> ObjectModel:
    """Reads the files of :func:`save_object`.

    Raises:
        FileNotFoundError: if one of the two files is missing.
        InputError: if a file is corrupted or of an unknown format.
    """
    folder = Path(folder)
    if not (folder / NUMBERS_FILE).is_file():
        raise FileNotFoundError(f"{folder} is not a built object: {NUMBERS_FILE} is missing")
    try:
        numbers = json.loads(read_text(folder / NUMBERS_FILE))
        if numbers["format"] != FORMAT_VERSION:
            raise InputError(f"format is {numbers['format']}, this version reads {FORMAT_VERSION}")
        known: dict[str, Any] = {key: numbers[key] for key in _SCALARS}
        if "box" in numbers:
            known |= {key: np.asarray(numbers[key], np.float64) for key in _WITHOUT_SURFACE}
            return _checked(_without_surface(np.asarray(numbers["box"], np.float64), known))
        if not (folder / MESH_FILE).is_file():
            raise FileNotFoundError(f"{folder} is not a built object: {MESH_FILE} is missing")
        vertices, faces, uv, texture = _read_glb(folder / MESH_FILE)
        known |= {key: np.asarray(numbers[key], dtype=np.float64) for key in _ARRAYS}
        model = ObjectModel(vertices=vertices, faces=faces, uv=uv, texture=texture, **known)
        return _checked(model)
    except (OSError, MemoryError):
        raise
    except Exception as error:  # trimesh raises all kinds of errors
        raise InputError(f"the object in {folder} cannot be read: {error}") from error


def _checked(model: ObjectModel) -> ObjectModel:
    """Returns an object whose numbers are valid; raises ValueError where one is not."""
    shapes = {
        "vertices": (None, 3), "faces": (None, 3), "uv": (None, 2), "points": (None, 3),
        "keypoints": (9, 3), "symmetries": (None, 4, 4), "stable_poses": (None, 4, 4),
    }  # fmt: skip
    for name, shape in shapes.items():
        array = getattr(model, name)
        fits = array.ndim == len(shape) and all(
            wanted in (None, side) for wanted, side in zip(shape, array.shape, strict=True)
        )
        if not fits or not np.isfinite(array).all() or not (len(array) or name == "points"):
            raise ValueError(f"{name} of shape {array.shape} is empty, not finite or misshapen")
    for name in ("symmetries", "stable_poses"):
        for number, T in enumerate(getattr(model, name)):
            check_rigid(T, f"{name} {number}", tolerance=1e-3)
    if model.faces.min() < 0 or model.faces.max() >= len(model.vertices):
        raise ValueError("faces name vertices that are not there")
    if len(model.uv) != len(model.vertices):
        raise ValueError(f"{len(model.uv)} texture coordinates of {len(model.vertices)} vertices")
    if not isinstance(model.name, str) or type(model.obj_id) is not int or model.obj_id < 0:
        raise ValueError(f"name and obj_id are {model.name!r:.40} and {model.obj_id!r:.40}")
    for name, low, high in (("diameter", 1e-9, 1e9), ("specular", 0, 1), ("shininess", 0, 1)):
        value = getattr(model, name)
        if not is_number(value) or not low <= value <= high:
            raise ValueError(f"{name} is {value!r:.40}")
    return model


def _without_surface(bounds: np.ndarray, known: dict[str, Any]) -> ObjectModel:
    """An object with its bounding box, from ``bounds`` (2, 3), in place of the mesh."""
    box = trimesh.creation.box(bounds=bounds)
    return ObjectModel(
        vertices=np.asarray(box.vertices, dtype=np.float64),
        faces=np.asarray(box.faces, dtype=np.int32),
        uv=np.zeros((len(box.vertices), 2), dtype=np.float32),
        texture=np.full((1, 1, 3), 128, dtype=np.uint8),
        points=np.empty((0, 3)),
        stable_poses=np.eye(4)[None],
        **known,
    )


def _read_glb(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces, uv and texture of the one mesh in a GLB file."""
    (mesh,) = trimesh.load_scene(path, process=False).geometry.values()
    texture = to_rgb(mesh.visual.material.baseColorTexture, f"the texture of {path}")
    return (
        np.asarray(mesh.vertices, dtype=np.float64),
        np.asarray(mesh.faces, dtype=np.int32),
        np.asarray(mesh.visual.uv, dtype=np.float32),
        texture,
    )
