"""The two-view pairs of a generated dataset, read from its files."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...core.geometry import invert
from ...pose_estimator.bop.dataset import BopImage, read_dataset
from ...pose_estimator.bop.models_info import read_models_info
from ...pose_estimator.bop.pairs import BopPair
from ...pose_estimator.bop.targets import MIN_VISIBLE_FRACTION
from ..simulation.scene_kinds import SCENE_KINDS
from ..simulation.trajectories.view_spread import viewing_angle
from .config import GenerateConfig
from .scene_plan import plan_scene, target_names


def two_view_pairs(config: GenerateConfig) -> Iterator[BopPair]:
    """Yields the pairs (reference view, second view) of the written scenes.

    Views on the sphere: the pairs whose angle at the target is within ``config.pair_angles``.
    Hand-held sequences and stereo rigs: the pairs of the gaps, or of left and right, one entry per
    target that is visible in the reference view; all objects of a ``heap`` scene are targets.
    """
    infos = read_models_info(config.out)
    obj_ids = {str(info.name): obj_id for obj_id, info in infos.items()}
    dataset = read_dataset(config.out, config.split)
    for scene_id in range(config.scenes):
        plan = plan_scene(config, scene_id, tuple(obj_ids))
        images = dataset.scene(scene_id)
        target = obj_ids[plan.target]
        targets = [obj_ids[name] for name in target_names(config, tuple(obj_ids))]
        for number, second_number in plan.pairs:
            first, second = images[number], images[second_number]
            pair = _pair(first, second, target)
            if config.annotations == "full":
                both = zip(first.annotations, second.annotations, strict=True)
                fractions = {a.obj_id: (a.visibility, b.visibility) for a, b in both}
                pair = replace(pair, visib_fracts=fractions)
            if plan.length is None and not plan.stereo:
                if config.pair_angles[0] <= pair.baseline_deg <= config.pair_angles[1]:
                    yield pair
                continue
            wanted = targets if SCENE_KINDS[plan.kind].all_targets else [target]
            gap = None if plan.stereo else second_number - number
            for a in first.annotations:
                if a.visibility >= MIN_VISIBLE_FRACTION and a.obj_id in wanted:
                    yield replace(pair, target_obj_id=a.obj_id, gap=gap)


def _pair(first: BopImage, second: BopImage, target: int) -> BopPair:
    assert first.T_cam_world is not None and second.T_cam_world is not None
    T_world_cam = invert(first.T_cam_world)
    return BopPair(
        scene_id=first.scene_id,
        ref_image_id=first.image_id,
        second_image_id=second.image_id,
        T_second_ref=second.T_cam_world @ T_world_cam,
        baselines_deg={
            a.obj_id: np.rad2deg(
                viewing_angle(
                    first.T_cam_world, second.T_cam_world, (T_world_cam @ a.T_cam_obj)[:3, 3]
                )
            )
            for a in first.annotations
        },
        target_obj_id=target,
    )
