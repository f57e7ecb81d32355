"""Builds the thirteen objects: the same versions of the libraries give the same bytes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import trimesh
import tyro
from tqdm import tqdm

from ...core.errors import InputError
from ...core.files import write_atomically
from .. import surface, texture
from ..object_model import ObjectModel
from ..storage import save_object
from .blueprints import BLUEPRINTS, Blueprint
from .contact_sheet import draw_contact_sheet
from .half_turn import HALF_TURN, mirror_quarter, quarter
from .solid_mesh import mesh_solid


@dataclass(frozen=True)
class BuildCommand:
    """Builds our thirteen LineMOD-style objects: meshes, textures, keypoints, resting poses.

    Every object is a formula (see `blueprints`) that is meshed, brought to the size of LineMOD's
    object of that name, unwrapped and painted. Each one becomes a folder with model.glb, which any
    mesh viewer opens, and object.json. The same command gives the same bytes.
    """

    out: Path = Path(__file__).parents[1] / "objects"
    """Folder to write to, one folder an object; by default the objects of the package itself."""

    only: Annotated[list[str], tyro.conf.UseAppendAction] = field(default_factory=list)
    """Names of the objects to build; all thirteen by default. The contact sheet shows these."""

    texture_size: int = 256
    """Side of each texture in texels."""

    def run(self) -> None:
        """Builds, with a progress bar.

        Raises:
            InputError: if a name in ``only`` is none of the thirteen.
        """
        unknown = sorted(set(self.only) - set(BLUEPRINTS))
        if unknown:
            raise InputError(f"--only names {unknown}, which is none of {list(BLUEPRINTS)}")
        names = [name for name in BLUEPRINTS if not self.only or name in self.only]
        models = {}
        progress = tqdm(names, unit="object")
        for name in progress:
            progress.set_postfix_str(name)
            models[name] = build_object(name, BLUEPRINTS[name], self.texture_size)
            save_object(models[name], self.out / name)
        write_atomically(self.out / "contact_sheet.png", draw_contact_sheet(models))


def build_object(name: str, blueprint: Blueprint, texture_size: int = 256) -> ObjectModel:
    """Meshes, unwraps and paints one object.

    Raises:
        InputError: if the solid cannot be meshed to its size, or does not stand upright.
    """
    solid = blueprint.solid()
    meshed = mesh_solid(solid, blueprint.extents, blueprint.diameter)

    def color_at(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return solid.color(meshed.to_solid(points), normals)

    base = quarter(meshed.mesh) if blueprint.symmetric else meshed.mesh
    vertices, faces, uv = texture.unwrap(base, texture_size)
    image = texture.bake(vertices, faces, uv, color_at, texture_size)
    if blueprint.symmetric:
        vertices, faces, uv = mirror_quarter(vertices, faces, uv)
        vertices *= np.asarray(blueprint.extents) / np.ptp(vertices, axis=0)
    # Files hold single precision; rounding first lets every derived number fit what is read back.
    vertices = vertices.astype(np.float32).astype(np.float64)
    mesh = trimesh.Trimesh(vertices, faces)
    clearance = surface.support_margin(mesh, tolerance=0.004 * blueprint.diameter)
    if clearance <= 0:
        raise InputError(f"{name} does not stand upright: its center of mass is off its base")
    symmetries = np.stack([np.eye(4), HALF_TURN] if blueprint.symmetric else [np.eye(4)])
    return ObjectModel(
        name=name,
        obj_id=blueprint.obj_id,
        vertices=vertices,
        faces=faces,
        uv=uv,
        texture=image,
        keypoints=surface.keypoints(vertices, np.zeros(3), symmetries),
        diameter=surface.diameter(vertices),
        symmetries=symmetries,
        points=surface.even_points(mesh),
        stable_poses=surface.stable_poses(mesh),
        specular=solid.specular,
        shininess=solid.shininess,
    )
