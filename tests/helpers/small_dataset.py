"""The smallest BOP dataset that has everything: one scene of two images of three objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from helpers.boxes import orbit
from helpers.solid_scenes import SHAPE, SOLIDS, K, frame, solid
from two_view_pose.core.geometry import invert, make_transform
from two_view_pose.pose_estimator.bop.dataset import read_dataset
from two_view_pose.pose_estimator.bop.models import write_evaluation_models, write_models
from two_view_pose.pose_estimator.bop.pairs import PAIRS_FILE, BopPair
from two_view_pose.pose_estimator.bop.targets import write_targets
from two_view_pose.pose_estimator.bop.writer import write_camera, write_pairs, write_scene

SCENE = "test/000000"
CAMERAS = [orbit(turn, 50, 0.75) for turn in (0, 20)]

_PLACES = ((-0.13, 0.05, 0), (0.12, 0.06, 0), (0, -0.11, 0))


def write_small_dataset(root: Path) -> None:
    """Writes images, masks, depth maps, models, camera.json, pairs and targets."""
    models = [solid(name) for name in SOLIDS]
    T_world_obj = {
        name: make_transform(np.eye(3), np.array(place, dtype=float))
        for name, place in zip(SOLIDS, _PLACES, strict=True)
    }
    write_scene(root, "test", 0, [frame(T_world_obj, T) for T in CAMERAS], jpeg_quality=None)
    pair = BopPair(
        scene_id=0,
        ref_image_id=0,
        second_image_id=1,
        T_second_ref=CAMERAS[1] @ invert(CAMERAS[0]),
        baselines_deg={model.obj_id: 20.0 for model in models},
        target_obj_id=1,
        gap=1,
        visib_fracts={model.obj_id: (1.0, 0.9) for model in models},
    )
    write_models(root, models)
    write_evaluation_models(root, models)
    write_camera(root, K, SHAPE)
    write_pairs(root / PAIRS_FILE, [pair, pair])
    write_targets(read_dataset(root))
