"""UV unwrapping, and baking a color function into a texture atlas.

MuJoCo needs one texture. Colors per vertex, per face or in other textures are all functions from
surface points to colors here, which are sampled at every texel of the atlas.
"""

from collections.abc import Callable

import numpy as np
import trimesh
import xatlas
from scipy import ndimage

from ..core.errors import InputError

ColorFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Maps surface points (N, 3) and unit normals (N, 3) to RGB colors (N, 3) in [0, 1]."""

PADDING = 6
"""Texels between charts, so that two levels of mip-maps do not mix neighboring charts."""

_UV_STEPS = 1 << 16  # exact in float32, and so is 1 - uv: files keep every bit


def unwrap(
    mesh: trimesh.Trimesh, size: int = 256, tight: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cuts a mesh into charts and packs them into one square atlas.

    Args:
        mesh: any triangle mesh.
        size: side of the texture in texels, for the padding.
        tight: search longer for the best packing.

    Returns:
        ``vertices`` (V, 3) float64 with seam vertices duplicated, ``faces`` (F, 3) int32 in the
        order of the mesh's faces, ``uv`` (V, 2) float32 in [0, 1], v up.
    """
    atlas = xatlas.Atlas()
    # Charting expects areas and lengths of about one.
    scaled = (mesh.vertices - mesh.bounds.mean(axis=0)) / mesh.extents.max()
    normals = mesh.vertex_normals
    atlas.add_mesh(
        scaled.astype(np.float32), mesh.faces.astype(np.uint32), normals.astype(np.float32)
    )
    charts = xatlas.ChartOptions()
    charts.max_cost = 6.0
    charts.max_iterations = 2
    packing = xatlas.PackOptions()
    packing.resolution = size
    packing.padding = PADDING
    packing.bruteForce = tight
    packing.bilinear = True
    atlas.generate(charts, packing)
    origin, faces, uv = atlas[0]
    uv = np.clip(np.round(uv.astype(np.float64) * _UV_STEPS) / _UV_STEPS, 0.0, 1.0)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)[origin]
    return vertices, faces.astype(np.int32), uv.astype(np.float32)


def bake(
    vertices: np.ndarray,
    faces: np.ndarray,
    uv: np.ndarray,
    color_at: ColorFunction,
    size: int = 256,
    supersampling: int = 2,
) -> np.ndarray:
    """Samples a color function over the atlas of a surface.

    Args:
        vertices: (V, 3) positions.
        faces: (F, 3) indices into ``vertices``.
        uv: (V, 2) texture coordinates, v up.
        color_at: called once with the surface points and face normals of the covered texels.
        size: side of the texture in texels.
        supersampling: samples along each side of a texel; 1 is enough for smooth colors.

    Returns:
        (size, size, 3) uint8 RGB, row 0 at v = 1. Uncovered texels have the color of the nearest
        covered one.

    Raises:
        InputError: if no texel is covered, or ``color_at`` returns a wrong shape.
    """
    fine = size * supersampling
    rows, columns, face, weights = rasterize(uv[faces].astype(np.float64), fine)
    if not len(rows):
        raise InputError(f"uv covers no texel of a {size} x {size} texture")
    corners = vertices[faces[face]]
    points = np.einsum("nk,nki->ni", weights, corners)
    directions = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    colors = np.asarray(color_at(points, directions / np.maximum(length, 1e-300)))
    if colors.shape != points.shape:
        raise InputError(
            f"color_at must return one RGB color per point, {points.shape}, got {colors.shape}"
        )
    image = np.zeros((fine, fine, 3))
    covered = np.zeros((fine, fine), dtype=bool)
    image[rows, columns] = np.clip(colors, 0.0, 1.0)
    covered[rows, columns] = True
    nearest = ndimage.distance_transform_edt(~covered, return_distances=False, return_indices=True)
    image = image[nearest[0], nearest[1]]
    blocks = image.reshape(size, supersampling, size, supersampling, 3)
    return np.round(blocks.mean(axis=(1, 3)) * 255.0).astype(np.uint8)


def sample_texture(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear colors (N, C) in [0, 1] of a texture (H, W, C) uint8 at uv (N, 2), repeating."""
    height, width = texture.shape[:2]
    x = (uv[:, 0] % 1.0) * width - 0.5
    y = (1.0 - uv[:, 1] % 1.0) * height - 0.5
    coordinates = np.stack([y, x])
    channels = [
        ndimage.map_coordinates(channel, coordinates, order=1, mode="grid-wrap")
        for channel in np.moveaxis(texture.astype(np.float64), -1, 0)
    ]
    return np.stack(channels, axis=1) / 255.0


def rasterize(
    triangles: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Finds the texel centers inside uv triangles (F, 3, 2).

    Returns:
        ``rows``, ``columns`` and ``face`` (N,), barycentric ``weights`` (N, 3). A texel on a
        shared edge appears once for each face; both give the same point.
    """
    pixels = np.stack([triangles[..., 0], 1.0 - triangles[..., 1]], axis=-1) * size - 0.5
    low = np.clip(np.ceil(pixels.min(axis=1)).astype(int), 0, size - 1)
    high = np.clip(np.floor(pixels.max(axis=1)).astype(int), 0, size - 1)
    spans = np.maximum(high - low + 1, 0)
    counts = spans[:, 0] * spans[:, 1]
    face = np.repeat(np.arange(len(pixels)), counts)
    offset = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    columns = low[face, 0] + offset % spans[face, 0]
    rows = low[face, 1] + offset // spans[face, 0]

    a, b, c = (pixels[face, k] for k in range(3))
    p = np.stack([columns, rows], axis=1).astype(np.float64)
    area = _cross(b - a, c - a)
    flat = np.abs(area) < 1e-12
    area = np.where(flat, 1.0, area)
    weights = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], axis=1)
    weights /= area[:, None]
    inside = ~flat & (weights.min(axis=1) >= -1e-9)
    return rows[inside], columns[inside], face[inside], weights[inside]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """z of the cross product of 2D vectors (N, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
