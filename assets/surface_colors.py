"""Samples the colors of a mesh at surface points, for every way to store colors."""

from collections.abc import Sequence

import numpy as np
import trimesh

from ..core.images import to_rgb
from .texture import sample_texture

DEFAULT_COLOR = np.array([0.62, 0.62, 0.62])
"""Of a mesh without colors, RGB in [0, 1]."""

NORMAL_WEIGHT = 0.05
"""Length of a normal in object diameters, for nearest-neighbor search over both."""

_SAMPLES = 150_000
_SEED = 0


def sample_colors(
    parts: Sequence[trimesh.Trimesh], count: int = _SAMPLES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples surface points of all parts, proportional to area, with their colors.

    Args:
        parts: meshes with per-vertex colors, per-face colors, a texture, or no colors.
        count: approximate number of points.

    Returns:
        Points (N, 3), unit normals (N, 3) and RGB colors (N, 3) in [0, 1].
    """
    rng = np.random.default_rng(_SEED)
    total = sum(part.area for part in parts)
    pieces = [
        _sample(part, int(np.ceil(count * part.area / total)), rng)
        for part in parts
        if part.area > 0
    ]
    points, normals, colors = (np.concatenate(columns) for columns in zip(*pieces, strict=True))
    return points, normals, colors


def _sample(
    part: trimesh.Trimesh, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals and colors of one part."""
    areas = part.area_faces
    face = rng.choice(len(areas), size=count, p=areas / areas.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    corners = part.triangles[face]
    points = np.einsum("nk,nki->ni", weights, corners)
    triangles = part.triangles
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return points, normals[face], _colors(part, face, weights)


def _colors(part: trimesh.Trimesh, face: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """RGB (N, 3) in [0, 1] at barycentric ``weights`` (N, 3) of the faces ``face`` (N,)."""
    visual = part.visual
    if isinstance(visual, trimesh.visual.TextureVisuals):
        image, factor = _image_and_factor(visual.material)
        if image is None or visual.uv is None:
            return np.tile(factor, (len(face), 1))
        uv = np.einsum("nk,nki->ni", weights, np.asarray(visual.uv)[part.faces[face], :2])
        return np.clip(sample_texture(image, uv) * factor, 0.0, 1.0)
    if visual is not None and visual.kind == "vertex":
        rgb = np.asarray(visual.vertex_colors)[:, :3] / 255.0
        return np.einsum("nk,nki->ni", weights, rgb[part.faces[face]])
    if visual is not None and visual.kind == "face":
        return np.asarray(visual.face_colors)[face, :3] / 255.0
    return np.tile(DEFAULT_COLOR, (len(face), 1))


def _image_and_factor(
    material: trimesh.visual.material.Material,
) -> tuple[np.ndarray | None, np.ndarray]:
    """A material's RGB texture (H, W, 3) uint8 or None, and the color that multiplies it."""
    if isinstance(material, trimesh.visual.material.PBRMaterial):
        image = material.baseColorTexture
        factor = material.baseColorFactor
        color = np.ones(3) if factor is None else np.asarray(factor[:3], dtype=float)
        if factor is not None and np.asarray(factor).dtype.kind in "ui":
            color = color / 255.0
    else:
        image = getattr(material, "image", None)
        # With a texture, exporters write any diffuse color, and viewers ignore it.
        color = np.ones(3) if image is not None else np.asarray(material.main_color[:3]) / 255.0
    return (None if image is None else to_rgb(image, "the texture")), color
