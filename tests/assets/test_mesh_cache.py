"""The disk cache of imported meshes: bit-exact, keyed by all inputs, optional."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.boxes import box_model
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


def import_again(path: Path, **options: object) -> ObjectModel:
    """Imports as another process would, without the cache in memory."""
    mesh_import.import_cached.cache_clear()
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


@pytest.mark.slow
def test_cached_object_is_bit_exact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_egg(tmp_path / "egg.ply")
    imported = import_again(path)
    with monkeypatch.context() as patch:
        patch.setattr(mesh_import, "import_uncached", None)
        assert_identical(imported, import_again(path))
    assert_identical(imported, mesh_import.import_uncached(path, None, "auto", None, None))


@pytest.mark.slow
def test_every_input_is_part_of_the_key(
    tmp_path: Path, cache_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_egg(tmp_path / "obj_000003.ply")
    half_turn = np.stack([np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])])
    names = [import_again(path).name, import_again(path, name="egg").name]
    assert names == ["obj_000003", "egg"]
    assert len(import_again(path, symmetries=half_turn).symmetries) == 2
    assert len(entries(cache_home)) == 3
    diameter = import_again(path).diameter
    assert len(entries(cache_home)) == 3
    write_egg(path, radius=0.06)
    assert import_again(path).diameter == pytest.approx(1.2 * diameter)
    assert len(entries(cache_home)) == 4
    monkeypatch.setattr(mesh_import, "CACHE_VERSION", mesh_import.CACHE_VERSION + 1)
    import_again(path)
    assert len(entries(cache_home)) == 5


def test_mesh_with_material_files_is_not_cached(tmp_path: Path, cache_home: Path) -> None:
    path = write_egg(tmp_path / "egg.obj")
    path.write_text("mtllib egg.mtl\n" + path.read_text())
    (tmp_path / "egg.mtl").write_text("newmtl a\nKd 1 0 0\n")
    import_again(path)
    assert not entries(cache_home)


def test_an_entry_of_an_unknown_compression_is_replaced(cache_home: Path) -> None:
    """Zip files damaged there raise NotImplementedError."""
    model = box_model("brick", 3, (0.12, 0.08, 0.06), symmetric=False)
    mesh_cache.cached("key", lambda: model)
    (entry,) = entries(cache_home)
    valid = entry.read_bytes()
    for start in (b"PK\x03\x04", b"PK\x01\x02"):
        at = valid.index(start) + {b"PK\x03\x04": 8, b"PK\x01\x02": 10}[start]
        entry.write_bytes(valid[:at] + b"\x63" + valid[at + 1 :])
        assert mesh_cache.cached("key", lambda: model).name == "brick"


@pytest.mark.slow
@pytest.mark.parametrize("garbage", [b"", b"PK\x03\x04 cut off", b"\x93NUMPY"])
def test_corrupted_entries_are_replaced(tmp_path: Path, cache_home: Path, garbage: bytes) -> None:
    path = write_egg(tmp_path / "egg.ply")
    imported = import_again(path)
    (entry,) = entries(cache_home)
    valid = entry.read_bytes()
    for corrupted in (garbage, valid[: len(valid) // 2], valid.replace(b"keypoints", b"keypaints")):
        entry.write_bytes(corrupted)
        assert_identical(imported, import_again(path))
        assert entry.read_bytes() == valid
    assert entries(cache_home) == [entry]  # and nothing lies beside it


@pytest.mark.slow
def test_a_cache_that_cannot_be_written_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_egg(tmp_path / "egg.ply")
    blocked = tmp_path / "a file"
    blocked.write_text("no folder")  # permissions do not stop root, this does
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert import_again(path).name == "egg"
    assert import_again(path).name == "egg"


def test_folder_follows_xdg(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert mesh_cache.cache_folder() == tmp_path / "cache" / "two_view_pose" / "meshes"
    monkeypatch.setenv("HOME", str(tmp_path))
    for ignored in ("", "relative/folder"):
        monkeypatch.setenv("XDG_CACHE_HOME", ignored)
        assert mesh_cache.cache_folder() == tmp_path / ".cache" / "two_view_pose" / "meshes"
