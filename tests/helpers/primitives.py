"""Small objects from trimesh's primitives, so that no test needs built assets."""

from __future__ import annotations

import numpy as np
import trimesh
from two_view_pose.assets.object_model import ObjectModel


def primitive_model(name: str, mesh: trimesh.Trimesh, obj_id: int = 1) -> ObjectModel:
    """An ObjectModel of a watertight mesh, textured with a color wheel of its directions."""
    mesh = mesh.copy()
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    directions = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    u = np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi) + 0.5
    v = directions[:, 2] / 2 + 0.5
    i = np.arange(64) / 63
    red, blue = np.meshgrid(i, 1 - i)
    texture = (255 * np.stack([red, np.full_like(red, 0.5), blue], axis=-1)).astype(np.uint8)
    upright = np.eye(4)
    upright[2, 3] = -mesh.bounds[0, 2]
    poses = [upright]
    stable, _ = mesh.compute_stable_poses(n_samples=1)
    poses += [T for T in stable if not np.allclose(T[2, :3], (0, 0, 1), atol=1e-3)][:3]
    points = trimesh.sample.sample_surface(mesh, 200, seed=0)[0]
    corners = np.linalg.norm(mesh.vertices, axis=1).argsort()[-8:]
    return ObjectModel(
        name=name,
        obj_id=obj_id,
        vertices=np.asarray(mesh.vertices, dtype=np.float64),
        faces=np.asarray(mesh.faces, dtype=np.int32),
        uv=np.stack([u, v], axis=1).astype(np.float32),
        texture=texture,
        keypoints=np.vstack([mesh.vertices[corners], np.zeros(3)]),
        diameter=2 * float(np.linalg.norm(mesh.vertices, axis=1).max()),
        symmetries=np.eye(4)[None],
        points=points,
        stable_poses=np.array(poses),
    )


def primitive_objects() -> dict[str, ObjectModel]:
    """Six objects of LineMOD's sizes."""
    meshes = {
        "brick": trimesh.creation.box((0.12, 0.07, 0.05)),
        "post": trimesh.creation.cylinder(0.03, 0.2, sections=24),
        "ball": trimesh.creation.icosphere(2, 0.05),
        "cone": trimesh.creation.cone(0.05, 0.14, sections=24),
        "ring": trimesh.creation.annulus(0.03, 0.06, 0.06, sections=24),
        "slab": trimesh.creation.box((0.15, 0.1, 0.03)),
    }
    return {name: primitive_model(name, m, i + 1) for i, (name, m) in enumerate(meshes.items())}
