"""Two small boxes, networks for them, and a BOP dataset of flat images with known poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.boxes import box_model, flat_frame, orbit
from scipy.spatial.transform import Rotation
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import invert, make_transform
from two_view_pose.pose_estimator.bop.models import write_models
from two_view_pose.pose_estimator.bop.pairs import BopPair
from two_view_pose.pose_estimator.bop.writer import write_pairs, write_scene
from two_view_pose.pose_estimator.networks.container import PoseNetworks
from two_view_pose.pose_estimator.training_data.crop_packing import pack_dataset
from two_view_pose.pose_estimator.training_data.crops import CropPack


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
    """Three scenes of three images each, with the pairs (0, 1) and (0, 2) of each scene."""
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
