"""The study's data sets: large enough, and with nothing in common."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from two_view_pose.assets import OBJECT_NAMES
from two_view_pose.envs.commands.study_data import TEST_SETS, ensure_test_set
from two_view_pose.envs.datagen.generate import GenerateConfig
from two_view_pose.envs.datagen.scene_plan import plan_scene
from two_view_pose.envs.simulation.scene import Scene, SceneConfig
from two_view_pose.pose_estimator.bop import dataset as bop
from two_view_pose.pose_estimator.evaluation.config import EvaluateConfig

TRAINING_SEEDS = (3, 7001)
"""Of the sets that the shipped weights were trained on, see README."""


def plans(config: GenerateConfig):
    names = config.objects or tuple(OBJECT_NAMES)
    return [plan_scene(config, i, names) for i in range(config.scenes)]


def test_seeds_are_all_different_from_each_other_and_from_the_usual_ones() -> None:
    seeds = [config.seed for config in TEST_SETS.values()] + [EvaluateConfig().seed]
    assert len(set(seeds)) == len(seeds)
    assert not set(seeds) & {*TRAINING_SEEDS, GenerateConfig(Path("x")).seed}


@pytest.mark.slow
def test_no_texture_and_no_camera_occurs_in_two_sets(objects) -> None:
    scene = Scene(objects, SceneConfig(clutter_objects=(0, 0), plain_shapes=(0, 0)))
    model = scene.world.model
    table = scene.world.textures["table"]
    start, size = model.tex_adr[table], 3 * model.tex_height[table] * model.tex_width[table]
    textures, cameras = [], []
    seeds = (*TRAINING_SEEDS, *(config.seed for config in TEST_SETS.values()))
    for seed in seeds:
        for scene_id in range(3):
            rng = np.random.default_rng(np.random.SeedSequence([seed, scene_id]))
            state = scene.reset(rng, "ball")
            textures.append(model.tex_data[start : start + size].tobytes())
            cameras.append(state.T_cam_world.tobytes())
    scene.graphics.close()
    assert len(set(textures)) == len(set(cameras)) == 3 * len(seeds)


def test_each_of_13_objects_has_100_reference_views_of_light_clutter() -> None:
    references: Counter[str] = Counter()
    for plan in plans(TEST_SETS["linemod"]):
        assert plan.kind == "linemod" and plan.length is not None
        assert {second - first for first, second in plan.pairs} == {1, 5, 10}
        references[plan.target] += len({first for first, _ in plan.pairs})
    assert set(references) == set(OBJECT_NAMES) and min(references.values()) >= 100


def test_occlusion_set_has_more_than_100_reference_views() -> None:
    config = TEST_SETS["occlusion"]
    assert {plan.kind for plan in plans(config)} == {"heap"}
    views = sum(len({first for first, _ in plan.pairs}) for plan in plans(config))
    assert views >= 120  # some objects cannot be seen in some


@pytest.mark.slow
def test_the_quick_set_is_rendered_once(tmp_path: Path) -> None:
    root = ensure_test_set("occlusion", tmp_path, quick=True, workers=1)
    assert root.parent == tmp_path
    (image, *others) = bop.read_dataset(root, "test")
    assert [i.image_id for i in (image, *others)] == [0, 1, 5, 10]
    assert len(image.annotations) == 8
    assert bop.read_depth(image).shape == bop.read_rgb(image).shape[:2] == (480, 640)
    pairs = bop.read_pairs(root)
    assert {pair.gap for pair in pairs} == {1, 5, 10}
    assert len({pair.target_obj_id for pair in pairs}) >= 6
    written = image.rgb_path.stat().st_mtime_ns
    assert ensure_test_set("occlusion", tmp_path, quick=True, workers=1) == root
    assert image.rgb_path.stat().st_mtime_ns == written
    with pytest.raises(ValueError, match="settings"):  # the folder holds something else
        (root / "manifest.json").write_text(
            (root / "manifest.json").read_text().replace('"seed":8002', '"seed":1')
        )
        ensure_test_set("occlusion", tmp_path, quick=True)


def test_unknown_sets_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="got 'tless'"):
        ensure_test_set("tless", tmp_path)
