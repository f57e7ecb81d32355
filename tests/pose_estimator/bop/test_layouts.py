"""Scenes of several cameras and BOP's other formats are refused by name, not as damaged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.solid_scenes import write_dataset
from two_view_pose.__main__ import main
from two_view_pose.core.errors import InputError
from two_view_pose.pose_estimator.bop.dataset import read_dataset


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("layouts") / "solids"
    write_dataset(root)
    return root


@pytest.fixture
def data(valid: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(valid, tmp_path / "solids"))


def several_cameras(scene: Path) -> None:
    """As BOP-Industrial's: scene_camera_cam1.json, rgb_cam1, and so on for each camera."""
    for path in list(scene.iterdir()):
        for camera in ("cam1", "photoneo"):
            target = path.with_name(f"{path.stem}_{camera}{path.suffix}")
            (shutil.copytree if path.is_dir() else shutil.copyfile)(path, target)
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def several_folders(scene: Path) -> None:
    """One scene_camera.json, and images by camera."""
    (scene / "rgb").rename(scene / "rgb_cam1")
    shutil.copytree(scene / "rgb_cam1", scene / "gray_cam2")


def by_image(scene: Path) -> None:
    """BOP's imagewise format."""
    cameras = json.loads((scene / "scene_camera.json").read_text())
    for key, camera in cameras.items():
        (scene / f"{int(key):06d}.camera.json").write_text(json.dumps(camera))
    for path in scene.glob("scene_*.json"):
        path.unlink()


LAYOUTS = {
    several_cameras: (
        r"scene_camera\.json is of one camera, .* several files of cameras: cam1, photoneo "
        r"\(copy .*scene_camera_cam1\.json to scene_camera\.json"
    ),
    several_folders: r"rgb is of one camera, .* several files of cameras: cam1, cam2",
    by_image: r"scene_camera\.json is of BOP's scenewise format, .* in its imagewise format",
}


@pytest.mark.parametrize("change", LAYOUTS)
def test_other_layouts_are_named(change: Callable[[Path], None], data, capsys, monkeypatch):
    for scene in (data / "test").iterdir():
        change(scene)
    with pytest.raises(InputError, match=LAYOUTS[change]):
        read_dataset(data).scene(3)
    monkeypatch.setenv("COLUMNS", "250")
    assert main(["check-data", str(data)]) == 1
    printed = capsys.readouterr().out
    assert "restore the file" not in printed and "2 errors" in printed


def test_a_camera_copied_as_the_remedy_says_is_read(data):
    scene = data / "test/000003"
    expected = read_dataset(data).scene(3)
    several_cameras(scene)
    for path in list(scene.glob("*_cam1*")):
        path.rename(path.with_name(path.name.replace("_cam1", "")))
    found = read_dataset(data).scene(3)
    assert found.keys() == expected.keys()
    assert all(found[i].rgb_path == expected[i].rgb_path for i in found)


def test_a_missing_file_of_one_camera_is_still_missing(data):
    (data / "test/000003/scene_camera.json").unlink()
    with pytest.raises(InputError, match=r"scene_camera\.json is missing"):
        read_dataset(data).scene(3)


def test_archives_and_splits_of_several_cameras_are_named(data):
    (data / "train_pbr").mkdir()
    (data / "train_pbr/shard-000000.tar").touch()
    with pytest.raises(InputError, match="webdataset format"):
        read_dataset(data, "train_pbr")
    for scene in (data / "test").iterdir():
        several_cameras(scene)
    with pytest.raises(InputError, match="available with --split: test"):
        read_dataset(data, "val")
