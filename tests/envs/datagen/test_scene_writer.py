"""Silhouettes and valid depth of generated scenes; what the basic layout leaves out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.silhouettes import drawn_silhouette
from two_view_pose.assets import load_object
from two_view_pose.envs.datagen.generate import GenerateConfig, generate
from two_view_pose.pose_estimator.bop import dataset as bop

pytestmark = pytest.mark.slow

NAMES = {1: "ape", 9: "duck", 10: "eggbox"}


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> GenerateConfig:
    config = GenerateConfig(
        tmp_path_factory.mktemp("data") / "set",
        scenes=2,
        views=3,
        objects=tuple(NAMES.values()),
        scene="occlusion",
        width=320,
        height=240,
        depth=True,
        depth_noise=True,
        workers=1,
        seed=5,
    )
    generate(config)
    return config


def read(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def annotated(config: GenerateConfig):
    """Each annotation with its entry in scene_gt_info.json, its two masks and its depth map."""
    for image in bop.read_dataset(config.out, config.split):
        folder = image.rgb_path.parents[1]
        infos = json.loads((folder / "scene_gt_info.json").read_text())[str(image.image_id)]
        depth = read(folder / "depth" / f"{image.image_id:06d}.png")
        for i, annotation in enumerate(image.annotations):
            name = f"{image.image_id:06d}_{i:06d}.png"
            visible, whole = (read(folder / kind / name) > 0 for kind in ("mask_visib", "mask"))
            yield image, annotation, infos[i], visible, whole, depth


def test_silhouettes_are_complete(config: GenerateConfig) -> None:
    hidden = 0
    for image, annotation, info, visible, whole, _ in annotated(config):
        assert not np.any(visible & ~whole)
        model = load_object(NAMES[annotation.obj_id])
        outline = drawn_silhouette(model, annotation.T_cam_obj, image.K, whole.shape)
        assert np.sum(whole ^ outline) <= 4
        left, top, width, height = annotation.bbox_obj
        inside = left >= 0 and top >= 0 and left + width < 320 and top + height < 240
        if inside:
            assert whole.sum() == info["px_count_all"]
            x, y, w, h = cv2.boundingRect(whole.astype(np.uint8))
            assert (x, y, w - 1, h - 1) == annotation.bbox_obj
        hidden += np.sum(whole) > 1.2 * np.sum(visible)
    assert hidden >= 3


def test_valid_pixels_are_those_of_the_silhouette_with_depth(config: GenerateConfig) -> None:
    holes = 0
    for _, _, info, _, whole, depth in annotated(config):
        assert info["px_count_valid"] == np.sum(depth[whole] > 0)
        holes += np.sum(depth[whole] == 0)
    assert holes > 0


def test_pairs_say_what_is_visible_in_both_views(config: GenerateConfig) -> None:
    dataset = bop.read_dataset(config.out, config.split)
    for pair in bop.read_pairs(config.out):
        images = dataset.scene(pair.scene_id)
        for obj_id, both in pair.visib_fracts.items():
            views = (images[i] for i in (pair.ref_image_id, pair.second_image_id))
            assert both == tuple(view.annotation(obj_id).visibility for view in views)
        assert pair.visib_fracts.keys() == pair.baselines_deg.keys()


def test_basic_annotations_leave_out_and_changes_nothing_else(
    config: GenerateConfig, tmp_path: Path
) -> None:
    basic = replace(config, out=tmp_path / "set", annotations="basic", scenes=1)
    generate(basic)
    full, scene = (c.out / c.split / "000000" for c in (config, basic))
    assert not (scene / "mask").exists()
    different = {"scene_gt_info.json", "SHA256SUMS"}
    for path in scene.rglob("*"):
        if path.is_file() and path.name not in different:
            assert path.read_bytes() == (full / path.relative_to(scene)).read_bytes()
    for entries in json.loads((scene / "scene_gt_info.json").read_text()).values():
        assert all(entry["px_count_valid"] == entry["px_count_all"] for entry in entries)
    assert "visib_fracts" not in (basic.out / "two_view_pairs.json").read_text()


def test_coco_can_be_asked_for_later(config: GenerateConfig) -> None:
    scene = config.out / config.split / "000000"
    image = next((scene / "rgb").iterdir())
    written = image.stat().st_mtime_ns
    generate(replace(config, coco=True))
    assert image.stat().st_mtime_ns == written
    coco = json.loads((scene / "scene_gt_coco.json").read_text())
    assert {c["id"] for c in coco["categories"]} == set(NAMES)
    assert "scene_gt_coco.json" in (scene / "SHA256SUMS").read_text()
    assert generate(replace(config, verify=True)) == 0


@pytest.mark.parametrize("change", [{"masks": False}, {"annotations": "basic"}])
def test_coco_without_silhouettes_is_refused(config: GenerateConfig, change) -> None:
    with pytest.raises(ValueError, match="coco needs masks of full silhouettes"):
        replace(config, coco=True, **change)
