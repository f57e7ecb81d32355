"""Imported meshes on the disk: the same to the bit, never out of date, never in the way."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import trimesh
from two_view_pose.assets import mesh_cache, mesh_import
from two_view_pose.assets.mesh_import import import_mesh
from two_view_pose.assets.object_model import ObjectModel


@pytest.fixture(autouse=True)
def cache_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, and textures small enough to be quick."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(mesh_import, "TEXTURE_SIZE", 64)
    return tmp_path / "cache"


def write_egg(path: Path, radius: float = 0.05) -> Path:
    """A small mesh with a color for each vertex."""
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=radius)
    mesh.vertices[:, 2] *= 1.3
    mesh.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (len(mesh.vertices), 3))
    mesh.export(path)
    return path


def import_afresh(path: Path, **options: object) -> ObjectModel:
    """Imports as another process would: it remembers nothing."""
    mesh_import._import.cache_clear()
    return import_mesh(path, **options)


def entries(cache_home: Path) -> list[Path]:
    """All files of the cache."""
    return sorted(file for file in cache_home.rglob("*") if file.is_file())


def assert_identical(first: ObjectModel, second: ObjectModel) -> None:
    """Every array has the same type and bits, everything else is equal."""
    for field in fields(ObjectModel):
        a, b = getattr(first, field.name), getattr(second, field.name)
        if isinstance(a, np.ndarray):
            assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), field.name
        else:
            assert a == b, field.name


def test_what_is_read_back_is_the_imported_object_to_the_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_egg(tmp_path / "egg.ply")
    imported = import_afresh(path)
    with monkeypatch.context() as patch:
        patch.setattr(mesh_import, "_make", None)
        assert_identical(imported, import_afresh(path))
    assert_identical(imported, mesh_import._make(path, None, "auto", None, None))


def test_everything_that_counts_makes_another_entry(
    tmp_path: Path, cache_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_egg(tmp_path / "obj_000003.ply")
    half_turn = np.stack([np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])])
    names = [import_afresh(path).name, import_afresh(path, name="egg").name]
    assert names == ["obj_000003", "egg"]
    assert len(import_afresh(path, symmetries=half_turn).symmetries) == 2
    assert len(entries(cache_home)) == 3
    diameter = import_afresh(path).diameter
    assert len(entries(cache_home)) == 3
    write_egg(path, radius=0.06)
    assert import_afresh(path).diameter == pytest.approx(1.2 * diameter)
    assert len(entries(cache_home)) == 4
    monkeypatch.setattr(mesh_import, "CACHE_VERSION", mesh_import.CACHE_VERSION + 1)
    import_afresh(path)
    assert len(entries(cache_home)) == 5


def test_a_mesh_that_takes_colors_from_other_files_is_not_kept(
    tmp_path: Path, cache_home: Path
) -> None:
    path = write_egg(tmp_path / "egg.obj")
    path.write_text("mtllib egg.mtl\n" + path.read_text())
    (tmp_path / "egg.mtl").write_text("newmtl a\nKd 1 0 0\n")
    import_afresh(path)
    assert not entries(cache_home)


@pytest.mark.parametrize("rubbish", [b"", b"PK\x03\x04 cut off", b"\x93NUMPY"])
def test_damaged_entries_are_replaced(tmp_path: Path, cache_home: Path, rubbish: bytes) -> None:
    path = write_egg(tmp_path / "egg.ply")
    imported = import_afresh(path)
    (entry,) = entries(cache_home)
    whole = entry.read_bytes()
    for damaged in (rubbish, whole[: len(whole) // 2], whole.replace(b"keypoints", b"keypaints")):
        entry.write_bytes(damaged)
        assert_identical(imported, import_afresh(path))
        assert entry.read_bytes() == whole
    assert entries(cache_home) == [entry]  # and nothing lies beside it


def test_a_cache_that_cannot_be_written_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_egg(tmp_path / "egg.ply")
    blocked = tmp_path / "a file"
    blocked.write_text("no folder")  # permissions do not stop root, this does
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert import_afresh(path).name == "egg"
    assert import_afresh(path).name == "egg"


def test_the_folder_is_where_the_specification_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert mesh_cache.cache_folder() == tmp_path / "cache" / "two_view_pose" / "meshes"
    monkeypatch.setenv("HOME", str(tmp_path))
    for ignored in ("", "relative/folder"):
        monkeypatch.setenv("XDG_CACHE_HOME", ignored)
        assert mesh_cache.cache_folder() == tmp_path / ".cache" / "two_view_pose" / "meshes"
