"""`models_eval` is checked too, and against `models`: errors are measured on it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from helpers.damage_tools import Damage, opened, rescale, set_key
from helpers.solid_scenes import IDS, solid
from scipy.spatial.transform import Rotation
from two_view_pose.core.errors import InputError
from two_view_pose.pose_estimator.bop.models import write_evaluation_models, write_models
from two_view_pose.pose_estimator.bop.objects import dataset_objects
from two_view_pose.pose_estimator.dataset_checks.checks import find_mistakes
from two_view_pose.pose_estimator.dataset_checks.config import CheckDataConfig

INFO = "models_eval/models_info.json"


@pytest.fixture
def data(tmp_path: Path) -> Path:
    objects = [solid(name) for name in IDS]
    write_models(tmp_path, objects)
    write_evaluation_models(tmp_path, objects)
    return tmp_path


def found(data: Path) -> list[dict[str, Any]]:
    """The findings of the models; there are no scenes."""
    findings, _, _ = find_mistakes(CheckDataConfig(data), data)
    return [r for r in findings.records() if r["problem"] != "the dataset has no scenes"]


def moved(change: np.ndarray) -> Callable[[Path], None]:
    """Moves a mesh and its entry alike, so that each folder agrees with itself."""

    def damage(data: Path) -> None:
        path = data / "models_eval/obj_000004.ply"
        mesh = trimesh.load_mesh(path, process=False)
        mesh.apply_transform(change)
        path.write_bytes(trimesh.exchange.ply.export_ply(mesh))
        with opened(data / INFO) as infos:
            for k, axis in enumerate("xyz"):
                infos["4"][f"min_{axis}"] = mesh.bounds[0, k]
                infos["4"][f"size_{axis}"] = mesh.extents[k]
            infos["4"]["diameter"] *= np.linalg.norm(change[:3, 0])

    return damage


def in_meters(data: Path) -> None:
    """All of the folder, as a tool that works in meters writes it."""
    rescale("models_eval/*.ply", 0.001)(data)
    with opened(data / INFO) as infos:
        for entry in infos.values():
            for name in entry.keys() - {"name", "symmetries_discrete"}:
                entry[name] /= 1000


def without(data: Path) -> None:
    with opened(data / INFO) as infos:
        del infos["4"]
    (data / "models_eval/obj_000004.ply").unlink()


TURN = np.eye(4)
TURN[:3, :3] = Rotation.from_euler("z", 180, degrees=True).as_matrix()
SHIFT = np.eye(4)
SHIFT[:3, 3] = 0, 0, 30

DAMAGES = {
    "in meters": Damage(in_meters, "obj_000001.ply", "vertices", "it is in meters", count=3),
    "in centimeters": Damage(
        moved(np.diag([0.1, 0.1, 0.1, 1])), "obj_000004.ply", "vertices", "it is in centimeters"
    ),
    "in inches": Damage(
        moved(np.diag([1 / 25.4] * 3 + [1])), "obj_000004.ply", "vertices", "it is in inches"
    ),
    "moved": Damage(moved(SHIFT), "obj_000004.ply", "vertices", "has another frame"),
    "turned": Damage(moved(TURN), "obj_000004.ply", "vertices", "has another frame"),
    "diameter": Damage(set_key(INFO, "1", "diameter", value=0.17), INFO, "diameter", "in meters"),
    "no symmetries": Damage(
        set_key(INFO, "7", "symmetries_discrete", value=[]),
        INFO, "symmetries_discrete, symmetries_continuous", "symmetries differ", "warning",
    ),
    "an object less": Damage(without, INFO, "keys", "only one of models and", "warning", 1),
    "no mesh": Damage(
        lambda d: (d / "models_eval/obj_000004.ply").unlink(),
        "models_eval/obj_000004.ply", "file", "an object has no mesh", count=1,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", DAMAGES)
def test_damage_of_models_eval_is_reported_once(case, data):
    damage = DAMAGES[case]
    damage.do(data)
    (record,) = found(data)
    assert damage.file in record["file"] and record["field"] == damage.field
    assert damage.words in f"{record['problem']}: {record['cause']}"
    assert (record["severity"] == damage.severity and record["value"] == damage.count) or 1


@pytest.mark.parametrize("layout", ["both", "no info", "points", "models", "models_eval"])
def test_valid_folders_have_no_findings(layout, data):
    if layout == "no info":
        (data / INFO).unlink()
    if layout == "points":
        for name, obj_id in IDS.items():
            dense = trimesh.Trimesh(solid(name).vertices, solid(name).faces).sample(3000, seed=0)
            cloud = trimesh.PointCloud(1000 * np.concatenate([dense, solid(name).vertices]))
            cloud.export(data / f"models_eval/obj_{obj_id:06d}.ply")
    if layout.startswith("models"):
        shutil.rmtree(data / {"models": "models_eval", "models_eval": "models"}[layout])
    assert found(data) == []


def test_a_folder_without_info_is_measured_by_that_of_models(data):
    (data / INFO).unlink()
    rescale("models_eval/*.ply", 0.1)(data)
    assert {r["problem"] for r in found(data)} == {
        "differs from the mesh",
        "the bounding box differs from the mesh",
        "the mesh has another size than in models",
    }


def test_models_of_another_name_are_named(data):
    shutil.move(data / "models", data / "models_cad")
    shutil.rmtree(data / "models_eval")
    assert [r["cause"] for r in found(data)] == ["the models are in models_cad"]
    with pytest.raises(InputError, match="rename one of its folders models_cad"):
        dataset_objects(data)


def test_evaluation_refuses_models_in_meters(data):
    in_meters(data)
    with pytest.raises(InputError, match=r"obj_000001\.ply is 0\.1\d* mm across.*in meters"):
        dataset_objects(data)


def test_evaluation_refuses_folders_that_differ(data):
    moved(np.diag([0.1, 0.1, 0.1, 1]))(data)
    with pytest.raises(InputError, match=r"object 4 is .* mm across in .*models_eval"):
        dataset_objects(data)
    infos = json.loads((data / INFO).read_text())
    assert list(dataset_objects(data, [1])) == [1] and "4" in infos
