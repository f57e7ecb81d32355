"""Writes the models of a BOP dataset: textured ``models`` and decimated ``models_eval``.

Both hold one PLY file in millimeters per object and the same ``models_info.json``, so that every
evaluation uses the same diameters and symmetries.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from ...assets import surface
from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...core.files import write_atomically
from .fields import MM
from .symmetries import split_continuous
from .writer import encode_image, write_json

EVALUATION_FACES = 1500
"""Triangles of a decimated mesh; the diameters of our objects change by less than 0.2 percent."""


def write_models(root: str | Path, objects: Iterable[ObjectModel]) -> None:
    """Writes textured PLY files in millimeters, and ``models_info.json``.

    In addition to BOP's fields, the file holds each object's ``name``.

    Raises:
        InputError: if two objects share an id.
    """
    objects = list(objects)
    folder = Path(root) / "models"
    infos = _infos(objects)
    for model in objects:
        ply = folder / f"obj_{model.obj_id:06d}.ply"
        png = ply.with_suffix(".png")
        write_atomically(png, encode_image(png, model.texture[..., ::-1]))
        write_atomically(ply, _textured_ply(model, png.name))
    write_json(folder / "models_info.json", infos)


def write_evaluation_models(root: str | Path, objects: Iterable[ObjectModel]) -> None:
    """Writes ``models_eval``: decimated meshes with normals, without texture, in millimeters.

    Raises:
        InputError: if two objects share an id.
    """
    objects = list(objects)
    folder = Path(root) / "models_eval"
    infos = _infos(objects)
    for model in objects:
        mesh = evaluation_mesh(model)
        mesh.apply_scale(MM)
        data = trimesh.exchange.ply.export_ply(mesh, vertex_normal=True)
        write_atomically(folder / f"obj_{model.obj_id:06d}.ply", data)
    write_json(folder / "models_info.json", infos)


def evaluation_mesh(model: ObjectModel, faces: int = EVALUATION_FACES) -> trimesh.Trimesh:
    """Returns an object's mesh without texture, decimated to at most ``faces`` triangles, meters.

    Vertices that texture seams duplicate are merged.
    """
    thinned = surface.simplified(model.vertices, model.faces, faces, 3.0, model.diameter)
    return trimesh.Trimesh(*thinned, process=False)


def _infos(objects: Iterable[ObjectModel]) -> dict[str, dict[str, Any]]:
    """Returns the content of ``models_info.json``."""
    infos: dict[str, dict[str, Any]] = {}
    for model in objects:
        if str(model.obj_id) in infos:
            other = infos[str(model.obj_id)]["name"]
            raise InputError(
                f"objects {other!r} and {model.name!r} share the id {model.obj_id}, which "
                "comes from their files' names: rename one of these"
            )
        entry: dict[str, Any] = {"name": model.name, "diameter": model.diameter * MM}
        for name, lengths in (("min", model.vertices.min(axis=0)), ("size", model.extents)):
            entry |= {f"{name}_{x}": float(v) for x, v in zip("xyz", lengths * MM, strict=True)}
        if model.symmetric:
            entry |= _symmetries(model.symmetries)
        infos[str(model.obj_id)] = entry
    return infos


def _symmetries(symmetries: np.ndarray) -> dict[str, Any]:
    """Returns BOP's fields of symmetry transforms (S, 4, 4), identity first."""
    discrete, axes = split_continuous(symmetries)
    fields: dict[str, Any] = {}
    if len(discrete):
        discrete = discrete.copy()
        discrete[:, :3, 3] *= MM
        fields["symmetries_discrete"] = discrete.reshape(-1, 16).tolist()
    if len(axes):
        fields["symmetries_continuous"] = [
            {"axis": axis[:3].tolist(), "offset": (axis[3:] * MM).tolist()} for axis in axes
        ]
    return fields


def _textured_ply(model: ObjectModel, texture: str) -> bytes:
    """Returns a PLY with the properties texture_u and texture_v that BOP's renderers read."""
    mesh = trimesh.Trimesh(model.vertices * MM, model.faces, process=False)
    uv = np.asarray(model.uv, dtype=np.float32)
    mesh.vertex_attributes = {"texture_u": uv[:, 0], "texture_v": uv[:, 1]}
    data = trimesh.exchange.ply.export_ply(mesh, vertex_normal=False)
    start = data.index(b"\nelement vertex")
    return data[:start] + f"\ncomment TextureFile {texture}".encode() + data[start:]
