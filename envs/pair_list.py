"""The two-view pairs of a generated dataset, read back from the disk."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..pose_estimator.bop import BopImage, read_dataset, read_models_info
from ..pose_estimator.bop_pairs import BopPair
from ..pose_estimator.geometry import invert
from .scene_plan import ScenePlan, plan_scene
from .view_spread import viewing_angle

if TYPE_CHECKING:
    from .generate import GenerateConfig

LEAST_VISIBLE = 0.1
"""Visible fraction in the reference view from which on an object counts as a target, as in BOP."""


def two_view_pairs(config: GenerateConfig) -> Iterator[BopPair]:
    """The pairs (reference view, further view) of the written scenes.

    Views around the sphere: the pairs whose angle at the target lies within ``config.pair_angles``.
    Hand-held sequences: the pairs of the gaps, one entry for each target that the reference view
    shows; all objects of a heap are targets.
    """
    infos = read_models_info(config.out)
    obj_ids = {str(info.name): obj_id for obj_id, info in infos.items()}
    dataset = read_dataset(config.out, config.split)
    for scene_id in range(config.scenes):
        plan = plan_scene(config, scene_id, tuple(obj_ids))
        images = dataset.scene(scene_id)
        target = obj_ids[plan.target]
        for first, second in plan.pairs:
            pair = _pair(images[first], images[second], target)
            if plan.length is None:
                if config.pair_angles[0] <= pair.baseline_deg <= config.pair_angles[1]:
                    yield pair
                continue
            for obj_id in _targets(plan, images[first], target):
                yield replace(pair, target_obj_id=obj_id, gap=second - first)


def _targets(plan: ScenePlan, reference: BopImage, target: int) -> list[int]:
    return [
        a.obj_id
        for a in reference.annotations
        if a.visibility >= LEAST_VISIBLE and (plan.kind == "heap" or a.obj_id == target)
    ]


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
