"""Fields of a dataset's JSON files that are not what they must be are refused by name."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from helpers.damage_tools import opened, set_key
from helpers.small_dataset import SCENE, write_small_dataset
from two_view_pose.core.errors import InputError
from two_view_pose.pose_estimator.bop.dataset import read_dataset
from two_view_pose.pose_estimator.bop.depth_unit import stored_depth_unit
from two_view_pose.pose_estimator.bop.manifest import read_manifest
from two_view_pose.pose_estimator.bop.models_info import read_models_info
from two_view_pose.pose_estimator.bop.pairs import PAIRS_FILE, read_pairs
from two_view_pose.pose_estimator.bop.targets import TARGETS_FILE, read_targets

HUGE = 10**400
"""A valid number of JSON that no float holds."""

GT, INFO = f"{SCENE}/scene_gt.json", f"{SCENE}/scene_gt_info.json"
CAMERA, MODELS = f"{SCENE}/scene_camera.json", "models/models_info.json"
SHEARED = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0.5, 1]
"""A transform whose last row is not 0 0 0 1."""


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("small") / "data"
    write_small_dataset(root)
    return root


@pytest.fixture
def data(valid: Path, tmp_path: Path) -> Path:
    return shutil.copytree(valid, tmp_path / "data")


def read(root: Path) -> None:
    dataset = read_dataset(root)
    for image in dataset:
        assert image.depth_path is not None
        stored_depth_unit(image.depth_path)
    for pair in read_pairs(root):
        assert 0 <= pair.baseline_deg <= 180
    for info in read_models_info(root).values():
        assert len(info.symmetries)
    read_targets(dataset)
    read_manifest(root)


def test_the_valid_files_are_read(data: Path) -> None:
    read(data)


@pytest.mark.parametrize(
    ("file", "keys", "value", "field"),
    [
        (GT, ("0", 0, "cam_t_m2c", 0), HUGE, "cam_t_m2c"),
        (GT, ("0", 0, "obj_id"), HUGE, "obj_id"),
        (GT, ("0", 0, "obj_id"), 1.5, "obj_id"),
        (GT, ("0", 0, "obj_id"), -1, "obj_id"),
        (GT, ("²",), [], "a key"),
        (GT, ("9" * 20,), [], "a key"),
        (INFO, ("0", 0, "visib_fract"), 7, "visib_fract"),
        (CAMERA, ("0", "depth_scale"), 0, "depth_scale"),
        (CAMERA, ("0", "depth_scale"), HUGE, "depth_scale"),
        (MODELS, ("1", "name"), ["duck"], "name"),
        (MODELS, ("1", "diameter"), 0, "diameter"),
        (MODELS, ("1", "size_y"), -3, "size"),
        (MODELS, ("7", "symmetries_discrete", 0), SHEARED, "last|row"),
        (MODELS, ("²",), {}, "an entry"),
        (PAIRS_FILE, (0, "scene_id"), -1, "scene_id"),
        (PAIRS_FILE, (0, "ref_image_id"), 0.5, "ref_image_id"),
        (PAIRS_FILE, (0, "target_obj_id"), 99, "target_obj_id"),
        (PAIRS_FILE, (0, "target_obj_id"), "1", "target_obj_id"),
        (PAIRS_FILE, (0, "baselines_deg", "²"), 3.0, "baselines_deg"),
        (PAIRS_FILE, (0, "visib_fracts", "1"), [1, -0.1], "visib_fracts"),
        (TARGETS_FILE, (0, "im_id"), 0.5, "im_id"),
        (TARGETS_FILE, (0, "inst_count"), HUGE, "inst_count"),
    ],
)
def test_invalid_values_are_refused(
    data: Path, file: str, keys: tuple[Any, ...], value: Any, field: str
) -> None:
    set_key(file, *keys, value=value)(data)
    with pytest.raises(InputError, match=f"{Path(file).name}.*({field})"):
        read(data)


def test_a_pair_of_a_recorded_scene_has_a_rigid_motion(data: Path) -> None:
    pair = {"im_a": 0, "im_b": 1, "T_b_a_mm": SHEARED, "objects": {"1": 20.0}}
    (data / PAIRS_FILE).write_text("{}")
    with opened(data / PAIRS_FILE) as content:
        content |= {"scene_id": 0, "pairs": [pair]}
    with pytest.raises(InputError, match=r"two_view_pairs\.json: pair 0.*row"):
        read(data)


def test_a_visible_fraction_may_be_rounded_up(data: Path) -> None:
    set_key(INFO, "0", 0, "visib_fract", value=1.0004)(data)
    assert next(iter(read_dataset(data))).annotations[0].visibility == 1.0


def test_names_of_files_that_are_no_ids_are_ignored(data: Path) -> None:
    (data / SCENE / "rgb" / "².png").write_bytes(b"")
    (data / "test" / "³").mkdir()
    read(data)


@pytest.mark.parametrize(
    "content",
    ["", "[]", "[" * 100_000, '{"settings": 3}', '{"settings": {"objects": 3}}', "\xff"],
)
def test_a_damaged_manifest_is_refused(data: Path, content: str) -> None:
    (data / "manifest.json").write_text(content, encoding="latin-1")
    with pytest.raises(InputError, match=r"manifest\.json"):
        read(data)
