"""Two small boxes, cameras around them, flat images of their silhouettes, and depth maps."""

from __future__ import annotations

import cv2
import numpy as np
import trimesh
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import LINEMOD_K, invert, make_transform, project, transform
from two_view_pose.pose_estimator.bop.boxes import bounding_box
from two_view_pose.pose_estimator.bop.dataset import BopAnnotation
from two_view_pose.pose_estimator.bop.writer import BopFrame

COLORS = {"brick": (220, 40, 40), "crate": (40, 60, 220)}


def box_model(name: str, obj_id: int, extents: tuple[float, ...], symmetric: bool) -> ObjectModel:
    """A box; the symmetric one looks the same after half a turn about z."""
    box = trimesh.creation.box(extents)
    corners = np.asarray(box.vertices)
    half_turn = make_transform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    return ObjectModel(
        name=name,
        obj_id=obj_id,
        vertices=corners,
        faces=np.asarray(box.faces, dtype=np.int32),
        uv=np.zeros((8, 2), np.float32),
        texture=np.full((4, 4, 3), COLORS[name], np.uint8),
        keypoints=np.vstack([corners, np.zeros(3)]),
        diameter=float(np.linalg.norm(extents)),
        symmetries=np.stack([np.eye(4), half_turn]) if symmetric else np.eye(4)[None],
        points=trimesh.sample.sample_surface(box, 200, seed=0)[0],
        stable_poses=np.eye(4)[None],
    )


def orbit(azimuth: float, elevation: float, distance: float) -> np.ndarray:
    """T_cam_world (4, 4) of a camera that looks at the world's origin, z up; degrees, meters."""
    azimuth, elevation = np.radians([azimuth, elevation])
    flat = np.cos(elevation)
    out = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    right = np.cross(-out, (0, 0, 1)) / flat
    rotation = np.stack([right, np.cross(-out, right), -out])
    return make_transform(rotation, np.array([0, 0, distance]))


def silhouette(model: ObjectModel, T_cam_obj: np.ndarray, K: np.ndarray) -> np.ndarray:
    """The mask (480, 640) of a convex object."""
    pixels = project(model.vertices @ T_cam_obj[:3, :3].T + T_cam_obj[:3, 3], K)
    mask = np.zeros((480, 640), np.uint8)
    hull = cv2.convexHull(pixels.astype(np.float32)).round().astype(np.int32)
    cv2.fillConvexPoly(mask, hull, 1)
    return mask.astype(bool)


def flat_frame(
    objects: dict[str, ObjectModel], T_world_obj: dict[str, np.ndarray], T_cam_world: np.ndarray
) -> BopFrame:
    """An image of plainly colored silhouettes side by side."""
    rgb = np.full((480, 640, 3), (120, 130, 110), np.uint8)
    annotations, masks = [], []
    for name, T in T_world_obj.items():
        model = objects[name]
        T_cam_obj = T_cam_world @ T
        mask = silhouette(model, T_cam_obj, LINEMOD_K)
        rgb[mask] = COLORS[name]
        box = bounding_box(mask)
        count = int(mask.sum())
        annotations.append(BopAnnotation(model.obj_id, T_cam_obj, 1.0, box, box, count, count))
        masks.append(mask)
    return BopFrame(rgb, LINEMOD_K, T_cam_world, annotations, masks)


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
