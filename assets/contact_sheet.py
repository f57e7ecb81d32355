"""A picture of a set of objects with their names, drawn without any graphics library.

The build must give the same bytes anywhere, and an object is drawn once in its life: a small
software rasteriser is enough.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .object_model import ObjectModel
from .texture import rasterise, sample_texture

_LIGHT = np.array([-0.35, -0.45, 0.82])
_BACKGROUND = np.array([0.90, 0.90, 0.88])


def draw_contact_sheet(
    objects: Mapping[str, ObjectModel],
    columns: int = 5,
    size: int = 240,
    views: tuple[tuple[float, float], ...] = ((40.0, 25.0),),
) -> np.ndarray:
    """Draws every object upright, each as large as fits.

    Args:
        objects: by name.
        columns: objects in a row.
        size: side of one picture in pixels.
        views: azimuth and elevation of the eye in degrees; each object is drawn once for each.

    Returns:
        (H, W, 3) uint8.
    """
    cells = []
    font = ImageFont.load_default(size=size // 12)
    for name, model in objects.items():
        pictures = [draw_object(model, azimuth, elevation, size) for azimuth, elevation in views]
        cell = Image.fromarray(np.concatenate(pictures, axis=1))
        ImageDraw.Draw(cell).text((8, 6), name, fill=(40, 40, 40), font=font)
        cells.append(np.asarray(cell))
    rows = -(-len(cells) // columns)
    blank = np.full_like(cells[0], np.round(_BACKGROUND * 255))
    cells += [blank] * (rows * columns - len(cells))
    lines = [np.concatenate(cells[k * columns : (k + 1) * columns], axis=1) for k in range(rows)]
    return np.concatenate(lines, axis=0)


def draw_object(
    model: ObjectModel, azimuth: float, elevation: float, size: int = 240
) -> np.ndarray:
    """Parallel projection of one object under a fixed light.

    Args:
        model: the object; it fills the picture.
        azimuth: of the eye about +z in degrees; 0 looks from +x, 90 from +y.
        elevation: of the eye above the horizon in degrees.
        size: side of the picture in pixels.

    Returns:
        (size, size, 3) uint8.
    """
    a, e = np.deg2rad([azimuth, elevation])
    back = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    axes = np.stack([right, np.cross(back, right), back])

    fine = 2 * size
    seen = model.vertices @ axes.T
    flat = seen[:, :2] - (seen[:, :2].min(axis=0) + seen[:, :2].max(axis=0)) / 2
    flat = flat / np.ptp(flat, axis=0).max() * 0.82 + [0.5, 0.46]
    rows, cols, face, weights = rasterise(flat[model.faces], fine)
    depth = np.einsum("nk,nk->n", weights, seen[model.faces[face], 2])
    order = np.argsort(depth, kind="stable")  # the nearest is written last
    rows, cols, face, weights = rows[order], cols[order], face[order], weights[order]

    corners = model.vertices[model.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    light = axes.T @ (_LIGHT / np.linalg.norm(_LIGHT))
    shade = 0.45 + 0.55 * np.clip(normals @ light, 0.0, 1.0)
    uv = np.einsum("nk,nki->ni", weights, model.uv[model.faces[face]].astype(np.float64))
    picture = np.tile(_BACKGROUND, (fine, fine, 1))
    picture[rows, cols] = sample_texture(model.texture, uv) * shade[face, None]
    picture = picture.reshape(size, 2, size, 2, 3).mean(axis=(1, 3))
    return np.round(np.clip(picture, 0.0, 1.0) * 255).astype(np.uint8)


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Writes a PNG under a temporary name and renames it."""
    temporary = path.with_name(path.name + ".tmp")
    Image.fromarray(picture).save(temporary, format="PNG", optimize=True)
    temporary.replace(path)
