"""Evaluation objects of a dataset."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.solid_scenes import IDS, solid
from scipy.spatial.transform import Rotation
from two_view_pose.pose_estimator.bop.models import write_evaluation_models, write_models
from two_view_pose.pose_estimator.bop.objects import dataset_objects, load_objects


@pytest.fixture
def root(tmp_path: Path) -> Path:
    write_models(tmp_path, [solid(name) for name in IDS])
    return tmp_path


def test_points_are_the_vertices_in_meters(root):
    objects = dataset_objects(root)
    assert {model.name: obj_id for obj_id, model in objects.items()} == IDS
    for model in objects.values():
        np.testing.assert_allclose(model.points, solid(model.name).vertices, atol=1e-7)
        assert model.diameter == pytest.approx(solid(model.name).diameter)
        assert model.symmetric == (model.name == "crate")
    np.testing.assert_allclose(objects[7].symmetries, solid("crate").symmetries)


def test_models_eval_has_priority_with_the_info_of_models(root):
    write_evaluation_models(root, [solid(name) for name in IDS])
    (root / "models_eval" / "models_info.json").unlink()
    path = root / "models_eval" / "obj_000007.ply"
    finer = trimesh.load_mesh(path, process=False).subdivide()
    path.write_bytes(trimesh.exchange.ply.export_ply(finer))
    objects = dataset_objects(root, [7])
    assert list(objects) == [7] and objects[7].symmetric
    np.testing.assert_allclose(objects[7].points, finer.vertices / 1000, atol=1e-7)


def test_meshes_without_faces_and_objects_without_a_name(root):
    path = root / "models" / "models_info.json"
    infos = json.loads(path.read_text())
    del infos["1"]["name"]
    path.write_text(json.dumps(infos))
    corners = trimesh.PointCloud(1000 * solid("bracket").vertices)
    corners.export(root / "models" / "obj_000001.ply")
    model = dataset_objects(root)[1]
    assert model.name == "obj_000001"
    np.testing.assert_allclose(model.points, solid("bracket").vertices, atol=1e-7)


def test_errors_name_file_and_object(root, tmp_path):
    with pytest.raises(ValueError, match=r"neither models_eval nor models"):
        dataset_objects(root / "models")
    with pytest.raises(ValueError, match=r"does not describe object 3; it has 1, 4, 7"):
        dataset_objects(root, [7, 3])
    path = root / "models" / "obj_000004.ply"
    content = path.read_bytes()
    meters = trimesh.Trimesh(solid("stairs").vertices, solid("stairs").faces, process=False)
    for broken, complaint in (
        (content[:400], r"obj_000004\.ply (cannot be read|must hold)"),
        (trimesh.exchange.ply.export_ply(meters), r"both must be in millimeters"),
    ):
        path.write_bytes(broken)
        with pytest.raises(ValueError, match=complaint):
            dataset_objects(root)
    path.unlink()
    with pytest.raises(ValueError, match=r"obj_000004\.ply is missing"):
        dataset_objects(root)
    (root / "models" / "models_info.json").unlink()
    with pytest.raises(ValueError, match=r"models_info\.json is missing"):
        dataset_objects(root)


@pytest.mark.slow
def test_bop_mesh_has_id_symmetries_and_diameter_of_models_info(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    mesh = trimesh.creation.cylinder(radius=20, height=90, sections=32)
    mesh.export(folder / "obj_000007.ply")
    low, size = mesh.bounds[0], mesh.extents
    entry = {"diameter": 99.0}
    entry |= {f"min_{axis}": low[k] for k, axis in enumerate("xyz")}
    entry |= {f"size_{axis}": size[k] for k, axis in enumerate("xyz")}
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    flip[2, 3] = 2.0
    entry["symmetries_discrete"] = [flip.ravel().tolist()]
    entry["symmetries_continuous"] = [{"axis": [0, 0, 1], "offset": [5, 0, 0]}]
    (folder / "models_info.json").write_text(json.dumps({"7": entry}))

    (model,) = load_objects(folder / "obj_000007.ply").values()
    assert model.obj_id == 7
    assert model.diameter == pytest.approx(0.099)
    assert model.symmetric and len(model.symmetries) >= 2 * 32
    np.testing.assert_array_equal(model.symmetries[0], np.eye(4))
    # Independent: a rotation about the axis through (5, 0, 0) mm leaves that point where it is.
    rotations = [S for S in model.symmetries if S[2, 2] > 0]
    for S in rotations:
        np.testing.assert_allclose(
            S[:3, :3] @ [0.005, 0, 0.01] + S[:3, 3], [0.005, 0, 0.01], atol=1e-9
        )
    angles = [Rotation.from_matrix(S[:3, :3]).magnitude() for S in rotations]
    assert np.diff(np.sort(angles)).max() < np.deg2rad(12)
    (folder / "models_info.json").write_text(json.dumps({"7": entry | {"diameter": 50.0}}))
    with pytest.raises(ValueError, match=r"diameter of 0\.098\d* m, but .* 0\.05 m.*info\.json"):
        load_objects([f"another={folder / 'obj_000007.ply'}"])
    assert any(np.allclose(S[:3, 3], [0, 0, 0.002]) and S[2, 2] < 0 for S in model.symmetries)


def test_units_of_meshes_with_and_without_models_info(tmp_path: Path, root: Path) -> None:
    trimesh.creation.box((14, 3, 8)).export(tmp_path / "brick.ply")
    (brick,) = load_objects(tmp_path / "brick.ply", "cm").values()
    np.testing.assert_allclose(brick.extents, (0.14, 0.03, 0.08), rtol=1e-6)
    with pytest.raises(ValueError, match=r"16\.4 mm in millimeters, .* pass --unit mm, cm, m or"):
        load_objects(tmp_path / "brick.ply")
    path = next((root / "models").glob("obj_*.ply"))
    with pytest.raises(ValueError, match=r"models_info\.json, so that it is in millimeters"):
        load_objects(path, "cm")
