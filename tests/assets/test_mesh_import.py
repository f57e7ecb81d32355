"""Meshes in every format, made with trimesh."""

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from two_view_pose import assets
from two_view_pose.assets import mesh_import
from two_view_pose.assets.mesh_import import import_mesh
from two_view_pose.assets.texture import sample_texture

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def small_textures(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of the detail is plenty for an egg, and saves half of the time."""
    monkeypatch.setattr(mesh_import, "TEXTURE_SIZE", 128)


def colors_at(model: assets.ObjectModel, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """Random surface points (N, 3) and the texture's colors there (N, 3)."""
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    points, face = trimesh.sample.sample_surface(mesh, count, seed=1)
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[face], points)
    uv = np.einsum("nk,nki->ni", weights, model.uv[model.faces[face]])
    return np.asarray(points), sample_texture(model.texture, uv)


def bottle(subdivisions: int = 2, scale: float = 0.1) -> trimesh.Trimesh:
    """An egg-shaped mesh of ``scale`` meters height, its middle off the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5)
    mesh.vertices *= (0.6, 0.8, 1.0)
    mesh.vertices += (0.1, 0.2, 0.3)
    mesh.vertices *= scale
    return mesh


def by_place(points: np.ndarray, scale: float = 0.1) -> np.ndarray:
    """Colors (N, 3) that vary linearly over the bottle."""
    return np.clip(points / scale * (0.8, 0.6, 0.5) + (0.4, 0.3, 0.2), 0.0, 1.0)


def paint_vertices(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Colors per vertex."""
    rgb = np.round(by_place(mesh.vertices) * 255).astype(np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=rgb)
    return mesh


def paint_faces(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Red below, green above, per face."""
    upper = mesh.triangles_center[:, 2] > mesh.bounds[:, 2].mean()
    rgba = np.where(upper[:, None], (0, 200, 0, 255), (200, 0, 0, 255)).astype(np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, face_colors=rgba)
    return mesh


def paint_texture(mesh: trimesh.Trimesh, physical: bool) -> trimesh.Trimesh:
    """A texture seen along x: blue at its top row, yellow at the bottom one."""
    low, high = mesh.bounds
    uv = ((mesh.vertices - low) / (high - low))[:, 1:]
    pixels = np.zeros((64, 64, 3), dtype=np.uint8)
    pixels[:32] = (0, 0, 250)
    pixels[32:] = (250, 250, 0)
    image = Image.fromarray(pixels)
    if physical:
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    else:
        material = trimesh.visual.material.SimpleMaterial(image=image)
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return mesh


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_vertex_colors_survive(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"egg{suffix}"
    paint_vertices(bottle()).export(path)
    model = import_mesh(path)
    assert model.name == "egg"
    points, colors = colors_at(model)
    assert np.abs(colors - by_place(points)).mean() < 0.02


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_face_colors_survive(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"egg{suffix}"
    paint_faces(bottle()).export(path)
    points, colors = colors_at(import_mesh(path))
    clear = np.abs(points[:, 2] - 0.03) > 0.01
    upper = points[:, 2] > 0.03
    expected = np.where(upper[:, None], (0, 200 / 255, 0), (200 / 255, 0, 0))
    assert np.abs(colors - expected)[clear].mean() < 0.02


@pytest.mark.parametrize("suffix", [".obj", ".glb"])
def test_textures_survive(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"egg{suffix}"
    paint_texture(bottle(), physical=suffix == ".glb").export(path)
    points, colors = colors_at(import_mesh(path))
    clear = np.abs(points[:, 2] - 0.03) > 0.005
    expected = np.where(points[:, 2:] > 0.03, (0, 0, 250 / 255), (250 / 255, 250 / 255, 0))
    assert np.abs(colors - expected)[clear].mean() < 0.02


def test_a_mesh_without_colors_is_gray(tmp_path: Path) -> None:
    path = tmp_path / "egg.stl"
    bottle().export(path)
    model = import_mesh(path)
    assert np.ptp(model.texture.reshape(-1, 3), axis=0).max() <= 1
    assert len(np.unique(model.vertices, axis=0)) == len(bottle().vertices)  # STL is welded


def test_scenes_become_one_object_with_all_colors(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for place, color in ((-0.05, (255, 0, 0, 255)), (0.05, (0, 0, 255, 255))):
        box = trimesh.creation.box(extents=(0.04, 0.04, 0.04))
        box.visual.face_colors = color
        scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([place, 0, 0]))
    scene.export(tmp_path / "pair.glb")
    model = import_mesh(tmp_path / "pair.glb")
    np.testing.assert_allclose(model.extents, (0.14, 0.04, 0.04), rtol=1e-5)
    points, colors = colors_at(model)
    expected = np.where(points[:, :1] < 0, (1, 0, 0), (0, 0, 1))
    assert np.abs(colors - expected).mean() < 0.01


def test_the_files_frame_is_kept(tmp_path: Path) -> None:
    mesh = bottle()
    mesh.export(tmp_path / "egg.ply")
    model = import_mesh(tmp_path / "egg.ply")
    vertices = [model.vertices.min(axis=0), model.vertices.max(axis=0)]
    np.testing.assert_allclose(vertices, mesh.bounds, atol=1e-6)
    np.testing.assert_allclose(model.keypoints[8], mesh.bounds.mean(axis=0), atol=1e-6)
    assert model.diameter == pytest.approx(0.1, rel=0.01)
    assert model.points.shape == (1000, 3)


@pytest.mark.parametrize(
    ("scale", "unit", "expected", "words"),
    [
        (0.1, "auto", 0.1, "read as meters, 100 mm across"),
        (100.0, "auto", 0.1, "read as millimeters, 100 mm across"),
        (5.0, "mm", 0.005, "read as millimeters, 5 mm across"),
        (0.015, "m", 0.015, "read as meters, 15 mm across"),
        (31.0, "cm", 0.31, "read as centimeters, 310 mm across"),
        (5.0, "inch", 0.127, "read as inches, 127 mm across"),
        (2, "m", 2.0, "read as meters, 2 m across"),
    ],
)
def test_units(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    scale: float,
    unit: str,
    expected: float,
    words: str,
) -> None:
    bottle(scale=scale).export(tmp_path / "egg.ply")
    for _ in range(2):  # also from the cache on disk
        mesh_import.import_cached.cache_clear()
        model = import_mesh(tmp_path / "egg.ply", unit=unit)
        assert model.diameter == pytest.approx(expected, rel=0.01)
        assert capsys.readouterr().out == f"egg.ply: {words}, no colors (gray)\n"
    assert import_mesh(tmp_path / "egg.ply", unit=unit) is model
    assert not capsys.readouterr().out


@pytest.mark.parametrize("scale", [0.001, 5.0, 5000.0])
def test_implausible_sizes(tmp_path: Path, scale: float) -> None:
    bottle(scale=scale).export(tmp_path / "egg.ply")
    with pytest.raises(ValueError, match=r"unit of .*egg\.ply.*diameter is \S+, .*unit='mm'"):
        import_mesh(tmp_path / "egg.ply")


def test_large_meshes_are_decimated_and_keep_their_colors(tmp_path: Path) -> None:
    mesh = paint_vertices(bottle(subdivisions=5))
    assert len(mesh.faces) > 20_000
    mesh.export(tmp_path / "egg.ply")
    model = import_mesh(tmp_path / "egg.ply")
    assert 3000 < len(model.faces) <= 4000
    np.testing.assert_allclose(model.extents, mesh.extents, rtol=0.01)
    points, colors = colors_at(model)
    assert np.abs(colors - by_place(points)).mean() < 0.02


def test_inverted_meshes_are_fixed(tmp_path: Path) -> None:
    mesh = bottle()
    mesh.invert()
    mesh.export(tmp_path / "egg.ply")
    model = import_mesh(tmp_path / "egg.ply")
    assert trimesh.Trimesh(model.vertices, model.faces).volume > 0


def test_stable_poses_of_a_box_and_a_cone(tmp_path: Path) -> None:
    trimesh.creation.box(extents=(0.1, 0.06, 0.2)).export(tmp_path / "box.ply")
    np.testing.assert_array_equal(
        import_mesh(tmp_path / "box.ply").stable_poses[0][:3, :3], np.eye(3)
    )
    cone = trimesh.creation.cone(radius=0.02, height=0.2, sections=24)
    cone.apply_transform(np.diag([1.0, -1.0, -1.0, 1.0]))
    cone.export(tmp_path / "cone.ply")
    assert import_mesh(tmp_path / "cone.ply").stable_poses[0][2, 2] < 0.9


def test_arguments_are_validated(tmp_path: Path) -> None:
    path = tmp_path / "egg.ply"
    bottle().export(path)
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    model = import_mesh(path, symmetries=half_turn[None])
    np.testing.assert_array_equal(model.symmetries, [np.eye(4), half_turn])
    with pytest.raises(ValueError, match=r"shape \(S, 4, 4\)"):
        import_mesh(path, symmetries=np.eye(3))
    with pytest.raises(ValueError, match=r"symmetries\[1\] is not rigid"):
        import_mesh(path, symmetries=np.stack([np.eye(4), np.diag([2.0, 2.0, 2.0, 1.0])]))
    assert import_mesh(path, diameter=0.105).diameter == 0.105
    with pytest.raises(ValueError, match=r"diameter of 0\.\d+ m, but diameter is given as 0\.2 m"):
        import_mesh(path, diameter=0.2)
    with pytest.raises(ValueError, match="unit must be"):
        import_mesh(path, unit="furlong")


def test_imports_are_cached_until_the_file_changes(tmp_path: Path) -> None:
    path = tmp_path / "egg.ply"
    bottle().export(path)
    first = import_mesh(path)
    assert import_mesh(path) is first
    bottle(subdivisions=1).export(path)
    assert len(import_mesh(path).faces) < len(first.faces)


def test_numbers_are_stable_and_names_can_be_given(tmp_path: Path) -> None:
    for name in ("mug", "jug"):
        bottle().export(tmp_path / f"{name}.ply")
    models = assets.load_objects(tmp_path)
    assert list(models) == ["jug", "mug"]
    assert models["jug"].obj_id != models["mug"].obj_id
    assert models["mug"].obj_id == 100_000 + _crc32(b"mug") % 900_000
    assert import_mesh(tmp_path / "mug.ply", "cup").name == "cup"
    mixed = assets.load_objects(["duck", tmp_path / "mug.ply"])
    assert list(mixed) == ["duck", "mug"]


def _crc32(data: bytes) -> int:
    """CRC-32 by long division, bit by bit."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ (0xEDB88320 if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def write_points(path: Path) -> None:
    trimesh.PointCloud(bottle().vertices).export(path)


def write_nan(path: Path) -> None:
    mesh = bottle()
    mesh.vertices[3, 1] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path.write_bytes(trimesh.exchange.ply.export_ply(mesh))


def write_flat(path: Path) -> None:
    vertices = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]
    trimesh.Trimesh(vertices, [[0, 1, 2]]).export(path)


def write_noise(path: Path) -> None:
    path.write_bytes(b"\x00\x01 this is not a mesh" * 20)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (write_points, r"egg\.ply has no faces"),
        (write_nan, r"NaN or infinite coordinates in 1 vert"),
        (write_flat, "flat"),
        (write_noise, r"egg\.ply cannot be read as a mesh"),
    ],
)
def test_unusable_files_are_refused(
    tmp_path: Path, write: Callable[[Path], None], message: str
) -> None:
    path = tmp_path / "egg.ply"
    write(path)
    with pytest.raises(ValueError, match=message):
        import_mesh(path)


def test_wrong_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nothing\.ply does not exist"):
        import_mesh(tmp_path / "nothing.ply")
    (tmp_path / "text.txt").write_text("hello")
    with pytest.raises(ValueError, match=r"text\.txt must be one of \.ply"):
        import_mesh(tmp_path / "text.txt")
    with pytest.raises(ValueError, match="has no mesh files"):
        assets.load_objects(tmp_path)
