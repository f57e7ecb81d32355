"""Which symmetries of a mesh check-data recognizes, and which listed ones it refutes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from two_view_pose.pose_estimator.dataset_checks.findings import Findings
from two_view_pose.pose_estimator.dataset_checks.meshes import read_models
from two_view_pose.pose_estimator.dataset_checks.models import check_models

CREATE = trimesh.creation
SHAPES = {
    "sphere": lambda: CREATE.icosphere(4, 40),
    "cylinder": lambda: CREATE.cylinder(30, 90, sections=96),
    "cone": lambda: CREATE.cone(30, 90, sections=96),
    "square prism": lambda: CREATE.box((60, 60, 90)),
    "hexagonal prism": lambda: CREATE.cylinder(40, 60, sections=6),
    "wedge": lambda: CREATE.box((60, 40, 90)).slice_plane((0, 0, 0), (1, 0.4, 0.7), cap=True),
}


def found(folder: Path, shape: str, **fields: object) -> list[tuple[str, str]]:
    """Field and detail of each finding for a shape 20 mm off the origin along x."""
    mesh = SHAPES[shape]()
    mesh.apply_translation(np.array([20, 0, 0]) - mesh.bounds.mean(axis=0))
    models = folder / "models"
    models.mkdir()
    mesh.export(models / "obj_000001.ply")
    distances = np.linalg.norm(mesh.vertices[:, None, :] - mesh.vertices[::7], axis=-1)
    entry = {"diameter": float(distances.max())} | fields
    for k, axis in enumerate("xyz"):
        entry |= {f"min_{axis}": mesh.bounds[0, k], f"size_{axis}": mesh.extents[k]}
    (models / "models_info.json").write_text(json.dumps({"1": entry}))
    findings = Findings()
    check_models(read_models(folder, findings)["models"].values(), findings)
    return [(record["field"], record["detail"]) for record in findings.records()]


@pytest.mark.parametrize(
    ("shape", "field", "words"),
    [
        ("sphere", "symmetries_continuous", "every turn about x, y, z: it is a sphere around 20 0"),
        ("cylinder", "symmetries_continuous", "every turn about z: it is a body of revolution"),
        ("cone", "symmetries_continuous", "every turn about z: it is a body of revolution"),
        ("square prism", "symmetries_discrete", "a half turn about x"),
        ("hexagonal prism", "symmetries_discrete", "a half turn about x"),
    ],
)
def test_missing_symmetries_are_recognized(shape, field, words, tmp_path):
    ((where, detail),) = found(tmp_path, shape)
    assert where == field and words in detail


@pytest.mark.parametrize(
    ("shape", "axes", "wrong"),
    [
        ("wedge", [], 0),
        ("cylinder", [(0, 0, 1)], 0),
        ("cone", [(0, 0, -3)], 0),
        ("sphere", [(1, 0, 0), (0, 1, 0), (0, 0, 1)], 0),
        ("cylinder", [(1, 0, 0)], 1),
        ("square prism", [(0, 1, 0)], 1),
    ],
)
def test_listed_axes_are_compared_with_the_mesh(shape, axes, wrong, tmp_path):
    listed = [{"axis": list(axis), "offset": [20, 0, 0]} for axis in axes]
    fields = [field for field, _ in found(tmp_path, shape, symmetries_continuous=listed)]
    assert fields == ["symmetries_continuous"] * wrong
