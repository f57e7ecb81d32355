"""check-data: no findings on valid data, and the right one for each kind of damage."""

from __future__ import annotations

import json
import random
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.damage_tools import (
    GL,
    SCENE,
    every_camera,
    every_image,
    every_pair,
    every_pose,
    inverted,
    opened,
    quaternion,
    truncate,
)
from helpers.damaged_images import IMAGES
from helpers.damaged_poses import POSES
from helpers.solid_scenes import write_dataset
from two_view_pose.__main__ import main

pytestmark = pytest.mark.slow

DAMAGES = POSES | IMAGES


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("valid") / "solids"
    root.mkdir()
    write_dataset(root)
    return root


@pytest.fixture
def data(valid: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    return Path(shutil.copytree(valid, tmp_path / "solids"))


@pytest.fixture(autouse=True)
def _wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


def check(data: Path, *options: str) -> tuple[int, list[dict[str, Any]]]:
    """The exit code of the command, and its findings."""
    results = data.parent / "findings.json"
    code = main(["check-data", str(data), "--json", str(results), *options])
    records = json.loads(results.read_text())["records"]
    return code, [record for record in records if record["metric"] == "findings"]


def test_valid_dataset_has_no_findings(valid, capsys):
    assert check(valid) == (0, [])
    printed = capsys.readouterr().out
    assert "0 errors, 0 warnings" in printed and "not checked" not in printed
    assert "3 objects, 2 scenes; checked 8 images, compared 24 projections" in printed


@pytest.mark.parametrize("case", DAMAGES)
def test_damage_is_reported(case, data, capsys):
    damage = DAMAGES[case]
    damage.do(data)
    code, records = check(data)
    out, err = capsys.readouterr()
    assert "Traceback" not in out + err
    assert code == int(any(r["severity"] == "error" for r in records))
    found = [
        r
        for r in records
        if damage.file in r["file"] and damage.field == r["field"]
        and damage.words in f"{r['problem']}: {r['cause']}"
    ]  # fmt: skip
    summary = [(r["severity"], r["file"], r["field"], r["problem"], r["cause"]) for r in records]
    assert found and found[0]["severity"] == damage.severity, summary
    if damage.count is not None:
        assert found[0]["value"] == damage.count
    assert damage.field in out and found[0]["problem"] in out and found[0]["remedy"] in out
    # One mistake must not be hidden by its consequences.
    assert len(records) <= 5, summary


VALUES = (None, float("nan"), -1, 0, 1e300, 10**30, "x", [], {}, [[]], {"a": 1}, True, [None] * 9)


@pytest.mark.parametrize("seed", range(12))
def test_random_json_values_do_not_crash(seed, data):
    """Any value of a JSON file, replaced by any other: findings, or none, but no failure."""
    rng = random.Random(seed)
    names = ("scene_gt.json", "scene_gt_info.json", "scene_camera.json")
    files = [data / SCENE / name for name in names]
    files += [data / name for name in ("models/models_info.json", "two_view_pairs.json")]
    for _ in range(3):
        with opened(rng.choice(files)) as content:
            while True:
                key = rng.choice(
                    list(content) if isinstance(content, dict) else range(len(content))
                )
                inner = content[key]
                if not isinstance(inner, list | dict) or not inner or rng.random() < 0.25:
                    content[key] = rng.choice(VALUES)
                    break
                content = inner
    code, records = check(data, "--images", "2")
    assert code == int(any(r["severity"] == "error" for r in records))


def test_equal_findings_are_grouped_with_first_examples(data, capsys):
    every_pose(data, lambda R, t: (R, t * np.nan))
    code, records = check(data)
    assert code == 1 and [r["value"] for r in records] == [24]
    out = capsys.readouterr().out
    assert "scene_gt.json, image 0, annotation 0" in out and "and 22 more" in out
    assert (records[0]["scene"], records[0]["image"], records[0]["annotation"]) == (0, 0, 0)


def test_warnings_exit_with_zero(data, capsys):
    (data / SCENE / "depth/000001.png").unlink()
    code, records = check(data)
    assert code == 0 and [r["severity"] for r in records] == ["warning"]
    assert "0 errors, 1 warning\n" in capsys.readouterr().out


def test_overlays_show_written_and_corrected_poses(data, tmp_path, capsys):
    every_pose(data, lambda R, t: (GL @ R, GL @ t))
    every_image(data, "rgb/*", lambda p: np.full_like(p, 128))
    out = tmp_path / "overlays"
    check(data, "--out", str(out), "--overlays", "3")
    files = sorted(out.iterdir())
    assert len(files) == 3
    assert all(str(file) in capsys.readouterr().out for file in files[:1])
    for file in files:
        rgb = cv2.imread(str(file))[..., ::-1].astype(int)
        left, right = np.array_split(rgb, 2, axis=1)
        # The mask's tint on both sides, the yellow outline of the corrected pose on the right.
        for half, least in ((left, 0), (right, 50)):
            tint = (half[..., 2] > half[..., 0] + 60) & (half[..., 1] > half[..., 0] + 60)
            yellow = (half[..., 0] > 200) & (half[..., 1] > 160) & (half[..., 2] < 80)
            assert tint.sum() > 500
            assert (yellow.sum() > least) == bool(least)


def test_pairs_are_skipped_where_poses_are_wrong(data, capsys):
    every_pose(data, lambda R, t: (R.T, -R.T @ t))
    every_pair(data, inverted("ref2second"))
    _, records = check(data)
    assert not any(r["field"] == "T_second_ref" for r in records)
    assert "pairs of 2 scenes were not checked" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("remove", "note", "compared"),
    [
        (["mask_visib"], "no masks (mask_visib) in 2 of 2 scenes of test; poses are", 24),
        (["mask_visib", "scene_gt_info.json"], "no pose was compared with an image", 0),
        (["scene_gt.json", "scene_gt_info.json"], "no poses (scene_gt.json) in 2 of 2 scenes", 0),
        (["scene_gt_info.json"], "no boxes and visible fractions (scene_gt_info.json) in 2", 24),
        (["depth"], "no depth maps (depth) in 2 of 2 scenes of test; only rgbd", 24),
        (["../../models"], "no pose was compared with an image", 0),
    ],
)
def test_what_a_dataset_lacks_is_said_to_be_unchecked(remove, note, compared, data, capsys):
    for scene in (data / "test").iterdir():
        for name in remove:
            path = scene / name
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    results = data.parent / "findings.json"
    assert main(["check-data", str(data), "--json", str(results)]) == 0
    assert f"not checked: {note}" in capsys.readouterr().out
    records = json.loads(results.read_text())["records"]
    assert any(r["metric"] == "not_checked" and note in r["problem"] for r in records)
    counts = {r["metric"]: r["value"] for r in records}
    assert counts["projections_compared"] == compared and counts["images_checked"] == 8


def test_training_without_masks_stops_at_once(data, tmp_path, capsys, monkeypatch):
    shutil.rmtree(data / SCENE / "mask_visib")

    def read_meshes(*_: object) -> None:
        raise AssertionError("the meshes take longest")

    where = "two_view_pose.pose_estimator.training.train_estimator.training_objects"
    monkeypatch.setattr(where, read_meshes)
    command = ["train-estimator", "--data", str(data), "--split", "test", "--out", str(tmp_path)]
    assert main(command) == 2
    assert "000003 has no masks (mask_visib), which training needs" in capsys.readouterr().err


def test_images_and_scenes_are_sampled(data, capsys):
    assert check(data, "--images", "2")[0] == 0
    assert "checked 2 images" in capsys.readouterr().out
    truncate(data / SCENE / "scene_gt.json")
    assert check(data, "--scenes", "1", "--split", "test")[0] == 0
    assert "1 scene;" in capsys.readouterr().out
    assert check(data, "--split", "train_pbr")[0] == 1
    assert "'train_pbr'" in capsys.readouterr().out


def test_names_are_found_below_bop_path(data, monkeypatch, capsys):
    monkeypatch.setenv("BOP_PATH", str(data.parent))
    assert main(["check-data", "solids"]) == 0
    assert main(["check-data", "no-such-set"]) == 2
    assert "no-such-set" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["scenes", "images", "overlays"])
def test_negative_options_are_rejected(option, valid, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["check-data", str(valid), f"--{option}", "-1"])
    assert stop.value.code == 2
    assert f"{option} must be >= 0" in capsys.readouterr().err


def test_valid_layouts_without_optional_files(data):
    """Without masks, depth, worlds, camera.json, pairs; gray JPEGs; fewer annotations."""
    (data / "camera.json").unlink()
    (data / "two_view_pairs.json").unlink()
    shutil.move(data / "models", data / "models_eval")
    for scene in sorted((data / "test").iterdir()):
        shutil.rmtree(scene / "depth")
        shutil.rmtree(scene / "mask_visib")
        (scene / "rgb").rename(scene / "gray")
        for path in sorted((scene / "gray").iterdir()):
            cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
            path.unlink()
    every_camera(data, lambda entry: [entry.pop(f"cam_{part}_w2c") for part in "Rt"] and None)
    for name in ("scene_gt.json", "scene_gt_info.json"):
        with opened(data / SCENE / name) as scene:
            del scene["2"]
            scene["1"].clear()
    assert check(data) == (0, [])
    for path in data.glob("test/*/scene_gt_info.json"):
        path.unlink()
    assert check(data) == (0, [])


def test_rounded_rotations_are_accepted(data):
    rng = np.random.default_rng(0)
    every_pose(data, lambda R, t: (R * (1 + 0.006 * rng.standard_normal((3, 3))), t))
    assert check(data) == (0, [])


def test_boxes_reveal_wrong_poses_without_masks(data):
    for scene in (data / "test").iterdir():
        shutil.rmtree(scene / "mask_visib")
    quaternion([3, 0, 1, 2])(data)
    code, records = check(data)
    assert code == 1
    assert any(
        "does not project onto its box" in r["problem"] and "w, x, y, z" in r["cause"]
        for r in records
    )


def test_missing_textures_are_warned_about(data, capsys):
    path = data / "models" / "obj_000001.ply"
    path.write_bytes(
        path.read_bytes().replace(b"\nelement", b"\ncomment TextureFile gone.png\nelement", 1)
    )
    code, records = check(data)
    assert code == 0 and [r["severity"] for r in records] == ["warning"]
    assert "colors of the mesh cannot be read" in capsys.readouterr().out
