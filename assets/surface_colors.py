"""Samples the colors of a mesh at surface points."""

from collections.abc import Sequence

import numpy as np

from .mesh_files import Part

NORMAL_WEIGHT = 0.05
"""Length of a normal in object diameters, for nearest-neighbor search over both."""

_SAMPLES = 150_000
_SEED = 0


def sample_colors(
    parts: Sequence[Part], count: int = _SAMPLES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples surface points of all parts, proportional to area, with their colors.

    Args:
        parts: meshes with their paint.
        count: approximate number of points.

    Returns:
        Points (N, 3), unit normals (N, 3) and RGB colors (N, 3) in [0, 1].

    Raises:
        InputError: if a part of the surface is transparent.
    """
    rng = np.random.default_rng(_SEED)
    areas = [part.mesh.area for part in parts]
    pieces = [
        _sample(part, int(np.ceil(count * area / sum(areas))), rng)
        for part, area in zip(parts, areas, strict=True)
        if area > 0
    ]
    points, normals, colors = (np.concatenate(columns) for columns in zip(*pieces, strict=True))
    return points, normals, colors


def _sample(
    part: Part, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and colors of one part."""
    mesh = part.mesh
    areas = mesh.area_faces
    face = rng.choice(len(areas), size=count, p=areas / areas.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    triangles = mesh.triangles
    points = np.einsum("nk,nki->ni", weights, triangles[face])
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return points, normals[face], part.paint.rgb(mesh.faces, face, weights)
