"""A small valid BOP dataset: objects made of boxes, with exact masks, depth and boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from helpers.boxes import box_depth, orbit
from scipy.spatial.transform import Rotation
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import invert, make_transform
from two_view_pose.pose_estimator.bop.boxes import bounding_box
from two_view_pose.pose_estimator.bop.dataset import BopAnnotation
from two_view_pose.pose_estimator.bop.models import write_models
from two_view_pose.pose_estimator.bop.pairs import BopPair
from two_view_pose.pose_estimator.bop.writer import BopFrame, write_camera, write_pairs, write_scene

SHAPE = (240, 320)
K = np.array([[286.0, 0, 162.5], [0, 287.0, 121.0], [0, 0, 1]])

# Each solid: extents and center of its boxes, meters.
SOLIDS: dict[str, tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]] = {
    "bracket": (((0.14, 0.05, 0.03), (0, 0, 0)), ((0.03, 0.05, 0.09), (-0.055, 0, 0.06))),
    "stairs": (
        ((0.12, 0.09, 0.03), (0, 0, 0)),
        ((0.05, 0.04, 0.04), (0.035, 0.025, 0.035)),
        ((0.02, 0.02, 0.05), (0.05, 0.035, 0.08)),
    ),
    "crate": (((0.11, 0.07, 0.05), (0, 0, 0)),),
}
IDS = {"bracket": 1, "stairs": 4, "crate": 7}
COLORS = {"bracket": (220, 60, 40), "stairs": (60, 190, 80), "crate": (50, 80, 220)}


def _part(extents: tuple[float, ...]) -> trimesh.Trimesh:
    return trimesh.creation.box(extents)


def solid(name: str) -> ObjectModel:
    """One of the solids; the crate alone is symmetric, by half turns about its axes."""
    boxes = [_part(e).apply_translation(center) for e, center in SOLIDS[name]]
    mesh = trimesh.util.concatenate(boxes)
    vertices = np.asarray(mesh.vertices)
    turns = [np.diag([*signs, 1.0]) for signs in ((1, 1, 1), (-1, -1, 1), (-1, 1, -1), (1, -1, -1))]
    distances = np.linalg.norm(vertices[:, None] - vertices, axis=-1)
    return ObjectModel(
        name=name,
        obj_id=IDS[name],
        vertices=vertices,
        faces=np.asarray(mesh.faces, dtype=np.int32),
        uv=np.zeros((len(vertices), 2), np.float32),
        texture=np.full((4, 4, 3), COLORS[name], np.uint8),
        keypoints=np.zeros((9, 3)),
        diameter=float(distances.max()),
        symmetries=np.stack(turns) if name == "crate" else np.eye(4)[None],
        points=vertices,
        stable_poses=np.eye(4)[None],
    )


def solid_depth(name: str, T_cam_obj: np.ndarray) -> np.ndarray:
    """Depth (H, W) of a solid alone, infinite in the background."""
    depth = np.full(SHAPE, np.inf, np.float32)
    for extents, center in SOLIDS[name]:
        T = T_cam_obj @ make_transform(np.eye(3), np.array(center, dtype=float))
        part = box_depth(_Box(extents), T, K, SHAPE)  # type: ignore[arg-type]
        depth = np.minimum(depth, np.where(part > 0, part, np.inf))
    return depth


class _Box:
    """The attributes of a model that `box_depth` reads."""

    def __init__(self, extents: tuple[float, ...]):
        self.vertices = np.asarray(_part(extents).vertices)


def frame(T_world_obj: dict[str, np.ndarray], T_cam_world: np.ndarray) -> BopFrame:
    """One image with its annotations, masks and depth map."""
    poses = {name: T_cam_world @ T for name, T in T_world_obj.items()}
    depths = {name: solid_depth(name, T) for name, T in poses.items()}
    front = np.min(list(depths.values()), axis=0)
    rgb = np.full((*SHAPE, 3), (120, 130, 110), np.uint8)
    annotations, masks = [], []
    for name, T in poses.items():
        amodal = np.isfinite(depths[name])
        visible = amodal & (depths[name] == front)
        rgb[visible] = COLORS[name]
        masks.append(visible)
        annotations.append(
            BopAnnotation(
                obj_id=IDS[name],
                T_cam_obj=T,
                visibility=visible.sum() / amodal.sum(),
                bbox_visib=bounding_box(visible),
                bbox_obj=bounding_box(amodal),
                px_count_visib=int(visible.sum()),
                px_count_all=int(amodal.sum()),
            )
        )
    depth = np.where(np.isfinite(front), front, 1.8)
    return BopFrame(rgb, K, T_cam_world, annotations, masks, depth)


def write_dataset(root: Path) -> None:
    """Two scenes of four images, models, camera.json and pairs."""
    rng = np.random.default_rng(4)
    models = {name: solid(name) for name in SOLIDS}
    pairs = []
    for scene_id in (0, 3):
        places = {"bracket": (-0.13, 0.05, 0), "stairs": (0.12, 0.06, 0), "crate": (0, -0.11, 0)}
        T_world_obj = {
            name: make_transform(
                Rotation.from_euler("zyx", rng.uniform(-60, 60, 3), degrees=True).as_matrix(),
                np.array(place, dtype=float),
            )
            for name, place in places.items()
        }
        start = rng.uniform(-30, 30)
        cameras = [orbit(start + turn, 50 + turn / 5, 0.75) for turn in (0, 20, 45, -30)]
        frames = [frame(T_world_obj, T) for T in cameras]
        write_scene(root, "test", scene_id, frames, jpeg_quality=None)
        for second in (1, 2):
            pairs.append(
                BopPair(
                    scene_id=scene_id,
                    ref_image_id=0,
                    second_image_id=second,
                    T_second_ref=cameras[second] @ invert(cameras[0]),
                    baselines_deg={number: 20.0 for number in IDS.values()},
                )
            )
    write_models(root, models.values())
    write_camera(root, K, SHAPE)
    write_pairs(root / "two_view_pairs.json", pairs)
