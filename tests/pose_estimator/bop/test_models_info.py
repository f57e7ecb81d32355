"""Round trip of models: sizes, symmetries and textures."""

import json

import numpy as np
import pytest
import trimesh
from two_view_pose.assets.object_model import ObjectModel
from two_view_pose.core.geometry import make_transform
from two_view_pose.pose_estimator.bop.models import write_models
from two_view_pose.pose_estimator.bop.models_info import read_models_info
from two_view_pose.pose_estimator.bop.symmetries import CONTINUOUS_SYMMETRY_STEPS


def box_model(obj_id: int = 10, name: str = "crate") -> ObjectModel:
    rng = np.random.default_rng(obj_id)
    box = trimesh.creation.box((0.1, 0.06, 0.04))
    vertices = np.asarray(box.vertices)
    return ObjectModel(
        name=name,
        obj_id=obj_id,
        vertices=vertices,
        faces=np.asarray(box.faces, dtype=np.int32),
        uv=rng.uniform(size=(len(vertices), 2)).astype(np.float32),
        texture=rng.integers(0, 255, (8, 16, 3), dtype=np.uint8),
        keypoints=np.concatenate([vertices, np.zeros((1, 3))]),
        diameter=float(np.linalg.norm((0.1, 0.06, 0.04))),
        symmetries=np.stack([np.eye(4), make_transform(np.diag([-1.0, -1, 1]), [0.001, 0, 0])]),
        points=vertices,
        stable_poses=np.eye(4)[None],
    )


def test_models_round_trip_and_load_with_their_texture(tmp_path):
    model = box_model()
    write_models(tmp_path, [model, box_model(2, "brick")])
    infos = read_models_info(tmp_path)
    info = infos[10]
    assert sorted(infos) == [2, 10] and info.name == "crate"
    assert info.diameter == pytest.approx(model.diameter, abs=1e-12)
    np.testing.assert_allclose(info.extents, (0.1, 0.06, 0.04), atol=1e-12)
    np.testing.assert_allclose(info.minimum, (-0.05, -0.03, -0.02), atol=1e-12)
    np.testing.assert_allclose(info.symmetries, model.symmetries, atol=1e-12)
    mesh = trimesh.load_mesh(info.mesh_path, process=False)
    np.testing.assert_allclose(mesh.extents, (100, 60, 40), rtol=1e-6)
    np.testing.assert_array_equal(mesh.faces, model.faces)
    np.testing.assert_allclose(mesh.visual.uv, model.uv)
    np.testing.assert_array_equal(np.asarray(mesh.visual.material.image)[..., :3], model.texture)


def test_duplicate_object_ids_are_rejected(tmp_path):
    with pytest.raises(ValueError, match="'crate' and 'brick' share the id 10"):
        write_models(tmp_path, [box_model(), box_model(10, "brick")])


def test_continuous_symmetry_rotates_about_its_axis(tmp_path):
    entry = {"diameter": 100, "symmetries_continuous": [{"axis": [0, 0, 2], "offset": [10, 0, 0]}]}
    entry |= {f"{part}_{axis}": 5 for part in ("min", "size") for axis in "xyz"}
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "models_info.json").write_text(json.dumps({"1": entry}))
    symmetries = read_models_info(tmp_path)[1].symmetries
    assert len(symmetries) == CONTINUOUS_SYMMETRY_STEPS
    # Points on the axis stay, and a point 20 mm off it is spread evenly on a circle.
    np.testing.assert_allclose(symmetries @ [0.01, 0, 0.3, 1], np.tile([0.01, 0, 0.3, 1], (72, 1)))
    circle = (symmetries @ [0.03, 0, 0, 1])[:, :2] - [0.01, 0]
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), 0.02)
    np.testing.assert_allclose(circle.mean(axis=0), 0, atol=1e-12)
