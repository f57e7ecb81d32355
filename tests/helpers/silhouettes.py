"""Silhouettes of meshes without our renderer."""

import cv2
import numpy as np
from two_view_pose.core.geometry import transform


def drawn_silhouette(model, T_cam_obj, K, shape):
    """The pixels whose centers lie in a projected triangle; projection is OpenCV's."""
    uv, _ = cv2.projectPoints(
        transform(T_cam_obj, model.vertices), np.zeros(3), np.zeros(3), K, None
    )
    triangles = uv[:, 0][model.faces]  # (F, 3, 2)
    first = np.ceil(triangles.min(axis=1))
    size = int((triangles.max(axis=1) - first).max()) + 1
    steps = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).reshape(-1, 2)
    pixels = first[:, None] + steps  # (F, size^2, 2): all that a triangle could hold
    sides = np.roll(triangles, -1, axis=1) - triangles
    offsets = pixels[:, None] - triangles[:, :, None]
    cross = sides[:, :, None, 0] * offsets[..., 1] - sides[:, :, None, 1] * offsets[..., 0]
    inside = np.all(cross >= 0, axis=1) | np.all(cross <= 0, axis=1)
    columns, rows = pixels[inside].astype(int).T
    seen = (columns >= 0) & (columns < shape[1]) & (rows >= 0) & (rows < shape[0])
    canvas = np.zeros(shape, dtype=bool)
    canvas[rows[seen], columns[seen]] = True
    return canvas
