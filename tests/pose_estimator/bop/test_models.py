"""Evaluation models keep the shape of the object."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist
from two_view_pose.assets import load_objects
from two_view_pose.pose_estimator.bop.models import (
    EVALUATION_FACES,
    evaluation_mesh,
    write_evaluation_models,
    write_models,
)
from two_view_pose.pose_estimator.bop.models_info import read_models_info

OBJECTS = load_objects(["ape", "eggbox", "lamp"])


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("models")
    write_models(root, OBJECTS.values())
    write_evaluation_models(root, OBJECTS.values())
    return root


@pytest.mark.parametrize("name", OBJECTS)
def test_decimated_meshes_keep_shape_and_diameter(root: Path, name: str) -> None:
    info = read_models_info(root, "models_eval")[OBJECTS[name].obj_id]
    mesh = trimesh.load_mesh(info.mesh_path, process=False)
    full = trimesh.load_mesh(root / "models" / info.mesh_path.name, process=False)
    assert len(mesh.faces) <= EVALUATION_FACES < len(full.faces)
    assert mesh.is_watertight
    measured = pdist(mesh.vertices).max() / 1000
    assert measured == pytest.approx(info.diameter, rel=5e-3)
    assert info.diameter == pytest.approx(OBJECTS[name].diameter)
    # Dense samples stand for the surfaces; they lie half a percent of the diameter apart.
    dense = {part: surface.sample(60_000, seed=0) for part, surface in ((0, mesh), (1, full))}
    for part in dense:
        away, _ = KDTree(dense[1 - part]).query(dense[part][:2000])
        assert away.max() < 0.015 * 1000 * info.diameter


def test_evaluation_models_have_normals_and_no_texture(root: Path) -> None:
    path = root / "models_eval" / "obj_000001.ply"
    header = path.read_bytes().split(b"end_header")[0].decode()
    assert "property float nx" in header and "texture" not in header.lower()
    assert {p.suffix for p in path.parent.iterdir()} == {".ply", ".json"}
    mesh = trimesh.load_mesh(path, process=False)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertex_normals, axis=1), 1.0, atol=1e-5)


def test_models_and_models_eval_share_models_info(root: Path) -> None:
    both = [
        json.loads((root / folder / "models_info.json").read_text())
        for folder in ("models", "models_eval")
    ]
    assert both[0] == both[1] and sorted(both[0]) == ["1", "10", "14"]
    assert "symmetries_discrete" not in both[0]["1"]
    (half_turn,) = both[0]["10"]["symmetries_discrete"]  # without the identity
    T = np.reshape(half_turn, (4, 4))
    mesh = trimesh.load_mesh(root / "models_eval" / "obj_000010.ply", process=False)
    points = np.asarray(mesh.sample(4000, seed=0))
    distances, _ = KDTree(points).query(points[:500] @ T[:3, :3].T + T[:3, 3])
    assert np.median(distances) < 0.02 * both[0]["10"]["diameter"]


def test_small_meshes_only_lose_duplicated_vertices() -> None:
    ape = OBJECTS["ape"]
    mesh = evaluation_mesh(ape, faces=len(ape.faces))
    assert len(mesh.faces) == len(ape.faces)
    assert len(mesh.vertices) == len(np.unique(ape.vertices, axis=0)) < len(ape.vertices)


def test_evaluation_models_are_deterministic(root: Path, tmp_path: Path) -> None:
    write_evaluation_models(tmp_path, OBJECTS.values())
    for path in (root / "models_eval").iterdir():
        assert (tmp_path / "models_eval" / path.name).read_bytes() == path.read_bytes()
