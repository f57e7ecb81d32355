"""Ideal depth maps of boxes."""

from __future__ import annotations

import numpy as np
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import invert, transform


def box_depth(
    model: ObjectModel, T_cam_obj: np.ndarray, K: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """Depth (H, W) float32 of a box, 0 outside it, by ray-box intersection (slab method)."""
    rows, columns = np.indices(shape)
    rays = np.stack([columns, rows, np.ones(shape)], -1) @ np.linalg.inv(K).T
    T_obj_cam = invert(T_cam_obj)
    origin, directions = transform(T_obj_cam, np.zeros(3)), rays @ T_obj_cam[:3, :3].T
    half = np.abs(model.vertices).max(0)
    ends = (np.stack([-half, half])[:, None, None] - origin) / directions
    near, far = ends.min(0).max(-1), ends.max(0).min(-1)
    return np.where((near < far) & (near > 0), near, 0).astype(np.float32)
