"""Two small boxes, networks for them, and a BOP dataset of flat pictures with known poses."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.pose_estimator.bop import BopAnnotation
from two_view_pose.pose_estimator.bop_boxes import bounding_box
from two_view_pose.pose_estimator.bop_models import write_models
from two_view_pose.pose_estimator.bop_pairs import BopPair
from two_view_pose.pose_estimator.bop_writer import (
    BopFrame,
    write_pairs,
    write_scene,
)
from two_view_pose.pose_estimator.crop_packing import pack_dataset
from two_view_pose.pose_estimator.crops import CropPack
from two_view_pose.pose_estimator.geometry import LINEMOD_K, invert, make_transform, project
from two_view_pose.pose_estimator.networks import PoseNetworks

sys.path.insert(0, str(Path(__file__).parent))  # for the stand-ins beside this file

COLOURS = {"brick": (220, 40, 40), "crate": (40, 60, 220)}


def box_model(name: str, obj_id: int, extents: tuple[float, ...], symmetric: bool) -> ObjectModel:
    """A box; the symmetric one looks the same after half a turn about z."""
    box = trimesh.creation.box(extents)
    corners = np.asarray(box.vertices)
    turn = make_transform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    return ObjectModel(
        name=name,
        obj_id=obj_id,
        vertices=corners,
        faces=np.asarray(box.faces, dtype=np.int32),
        uv=np.zeros((8, 2), np.float32),
        texture=np.full((4, 4, 3), COLOURS[name], np.uint8),
        keypoints=np.vstack([corners, np.zeros(3)]),
        diameter=float(np.linalg.norm(extents)),
        symmetries=np.stack([np.eye(4), turn]) if symmetric else np.eye(4)[None],
        points=trimesh.sample.sample_surface(box, 200, seed=0)[0],
        stable_poses=np.eye(4)[None],
    )


def orbit(azimuth: float, elevation: float, distance: float) -> np.ndarray:
    """T_cam_world (4, 4) of a camera that looks at the world's origin, z up; degrees, metres."""
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
    """A picture of plainly coloured silhouettes side by side."""
    rgb = np.full((480, 640, 3), (120, 130, 110), np.uint8)
    annotations, masks = [], []
    for name, T in T_world_obj.items():
        model = objects[name]
        T_cam_obj = T_cam_world @ T
        mask = silhouette(model, T_cam_obj, LINEMOD_K)
        rgb[mask] = COLOURS[name]
        box = bounding_box(mask)
        count = int(mask.sum())
        annotations.append(BopAnnotation(model.obj_id, T_cam_obj, 1.0, box, box, count, count))
        masks.append(mask)
    return BopFrame(rgb, LINEMOD_K, T_cam_world, annotations, masks)


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def boxes() -> dict[str, ObjectModel]:
    """``brick``, and the symmetric ``crate``."""
    return {
        "brick": box_model("brick", 3, (0.12, 0.08, 0.06), symmetric=False),
        "crate": box_model("crate", 7, (0.1, 0.06, 0.08), symmetric=True),
    }


@pytest.fixture(scope="session")
def networks(boxes: dict[str, ObjectModel]) -> PoseNetworks:
    """Untrained networks for the boxes, in evaluation mode. Tests must not change them."""
    torch.manual_seed(0)
    return PoseNetworks(boxes).eval()


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory, boxes: dict[str, ObjectModel]) -> Path:
    """Three scenes of three pictures each, with the pairs (0, 1) and (0, 2) of each scene."""
    root = tmp_path_factory.mktemp("boxes")
    rng = np.random.default_rng(0)
    pairs = []
    for scene in range(3):
        places = {"brick": (-0.1, 0.02, 0.0), "crate": (0.1, -0.03, 0.0)}
        T_world_obj = {
            name: make_transform(
                Rotation.from_euler("z", rng.uniform(0, 360), degrees=True).as_matrix(), place
            )
            for name, place in places.items()
        }
        azimuth = rng.uniform(-20, 20)
        cameras = [orbit(azimuth + turn, 60, 0.9) for turn in (0, 25, -30)]
        frames = [flat_frame(boxes, T_world_obj, camera) for camera in cameras]
        write_scene(root, "train_pbr", scene, frames, jpeg_quality=None)
        for second, name in ((1, "brick"), (2, "crate")):
            pairs.append(
                BopPair(
                    scene_id=scene,
                    ref_image_id=0,
                    second_image_id=second,
                    T_second_ref=cameras[second] @ invert(cameras[0]),
                    baselines_deg={model.obj_id: 20.0 for model in boxes.values()},
                    target_obj_id=boxes[name].obj_id,
                )
            )
    write_models(root, boxes.values())
    write_pairs(root / "two_view_pairs.json", pairs)
    return root


@pytest.fixture(scope="session")
def pack(dataset: Path, boxes: dict[str, ObjectModel]) -> CropPack:
    """The dataset, packed for training."""
    return pack_dataset(dataset, boxes)
