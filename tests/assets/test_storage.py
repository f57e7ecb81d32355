"""Files of objects."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import trimesh
from two_view_pose import assets
from two_view_pose.assets.storage import read_object, save_object
from two_view_pose.core.errors import InputError
from two_view_pose.pose_estimator.evaluation.metrics import add_or_add_s


def test_round_trip_keeps_every_bit(tmp_path: Path) -> None:
    model = assets.load_object("cat")
    save_object(model, tmp_path / "cat")
    again = read_object(tmp_path / "cat")
    for entry in fields(model):
        before, after = getattr(model, entry.name), getattr(again, entry.name)
        if isinstance(before, np.ndarray):
            assert before.dtype == after.dtype
        np.testing.assert_array_equal(before, after)
    assert {path.name for path in (tmp_path / "cat").iterdir()} == {"model.glb", "object.json"}


def test_any_viewer_reads_the_mesh(tmp_path: Path) -> None:
    model = assets.load_object("phone")
    save_object(model, tmp_path)
    mesh = trimesh.load_mesh(tmp_path / "model.glb")
    np.testing.assert_allclose(mesh.extents, model.extents, rtol=1e-6)
    assert mesh.visual.kind == "texture"
    assert mesh.visual.material.baseColorTexture.size == model.texture.shape[1::-1]


def test_corrupted_files(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"object\.json is missing"):
        read_object(tmp_path)
    save_object(assets.load_object("ape"), tmp_path)
    numbers = tmp_path / "object.json"
    text = numbers.read_text()
    (tmp_path / "model.glb").rename(tmp_path / "aside.glb")
    with pytest.raises(FileNotFoundError, match=r"model\.glb is missing"):
        read_object(tmp_path)
    (tmp_path / "aside.glb").rename(tmp_path / "model.glb")
    numbers.write_text(text[: len(text) // 2])
    with pytest.raises(ValueError, match="cannot be read"):
        read_object(tmp_path)
    numbers.write_text(text.replace('"format": 1', '"format": 99'))
    with pytest.raises(ValueError, match="format is 99"):
        read_object(tmp_path)
    numbers.write_text(text)
    mesh = tmp_path / "model.glb"
    mesh.write_bytes(mesh.read_bytes()[:1000])
    with pytest.raises(ValueError, match="cannot be read"):
        read_object(tmp_path)


def test_object_without_its_surface(tmp_path: Path) -> None:
    model = assets.load_object("eggbox")
    save_object(model, tmp_path / "eggbox", surface=False)
    assert [path.name for path in (tmp_path / "eggbox").iterdir()] == ["object.json"]
    again = read_object(tmp_path / "eggbox")
    assert not again.has_surface
    for name in ("keypoints", "symmetries"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))
    assert (again.name, again.obj_id, again.diameter) == ("eggbox", 10, model.diameter)
    np.testing.assert_allclose(again.extents, model.extents, atol=1e-12)
    assert len(again.vertices) == 8
    stored = (tmp_path / "eggbox" / "object.json").read_text()
    assert len(stored) < 3000
    with pytest.raises(ValueError, match=r"surface of eggbox.*--objects eggbox=FILE"):
        add_or_add_s(np.eye(4), np.eye(4), again)


@pytest.mark.slow
def test_names_can_be_chosen(tmp_path: Path) -> None:
    mesh = tmp_path / "obj_000007.ply"
    trimesh.creation.box((0.1, 0.2, 0.3)).export(mesh)
    objects = assets.load_objects([f"bracket={mesh}", "duck"])
    assert list(objects) == ["bracket", "duck"]
    assert objects["bracket"].obj_id == 7
    save_object(objects["bracket"], tmp_path / "built")
    assert assets.load_object(f"arm={tmp_path / 'built'}").name == "arm"
    with pytest.raises(FileNotFoundError, match=r"nothing\.ply"):
        assets.load_object(f"bracket={tmp_path / 'nothing.ply'}")
    strange = tmp_path / "a=b.ply"
    trimesh.creation.box((0.1, 0.2, 0.3)).export(strange)
    assert assets.load_object(str(strange)).name == "a=b"


@pytest.mark.parametrize(
    ("name", "value"),
    [("points", [[0.0, 0.0, float("nan")]]), ("keypoints", [[0.0, 0.0, 0.0]]), ("diameter", 0),
     ("symmetries", [[[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]]),
     ("stable_poses", []), ("name", 3), ("obj_id", 1.5), ("specular", 7), ("shininess", None)],
)  # fmt: skip
def test_invalid_numbers_are_refused(tmp_path: Path, name: str, value: object) -> None:
    save_object(assets.load_object("ape"), tmp_path)
    path = tmp_path / "object.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}))
    with pytest.raises(InputError, match=f"{tmp_path} cannot be read.*{name}"):
        read_object(tmp_path)


@pytest.mark.parametrize("place", [4, 20, 60])
def test_damaged_meshes_are_refused(tmp_path: Path, place: int) -> None:
    """The version, and the JSON, of which trimesh guesses the encoding by a missing library."""
    save_object(assets.load_object("ape"), tmp_path)
    mesh = bytearray((tmp_path / "model.glb").read_bytes())
    mesh[place] = 0xFF
    (tmp_path / "model.glb").write_bytes(mesh)
    with pytest.raises(InputError, match=f"{tmp_path} cannot be read"):
        read_object(tmp_path)


def test_endless_nesting_is_refused(tmp_path: Path) -> None:
    (tmp_path / "object.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match=f"{tmp_path} cannot be read"):
        read_object(tmp_path)
