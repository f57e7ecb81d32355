"""The thirteen shipped objects against LineMOD's sizes."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist
from two_view_pose import assets
from two_view_pose.assets.texture import sample_texture

# Number, diameter and extents in millimeters, from LineMOD's models_info.json.
LINEMOD = {
    "ape": (1, 102.099, (75.87, 77.6, 91.77)),
    "benchvise": (2, 247.506, (215.67, 121.86, 219.41)),
    "cam": (4, 172.492, (136.66, 143.03, 100.5)),
    "can": (5, 201.404, (100.79, 181.8, 193.73)),
    "cat": (6, 154.546, (67.01, 127.63, 117.46)),
    "driller": (8, 261.472, (229.48, 75.47, 208.0)),
    "duck": (9, 108.999, (104.43, 77.41, 85.7)),
    "eggbox": (10, 164.628, (150.18, 107.08, 69.24)),
    "glue": (11, 175.889, (36.72, 77.87, 172.82)),
    "holepuncher": (12, 145.543, (100.89, 108.5, 90.8)),
    "iron": (13, 278.078, (258.23, 118.48, 141.13)),
    "lamp": (14, 282.601, (203.15, 117.75, 213.12)),
    "phone": (15, 212.358, (93.92, 147.43, 184.75)),
}


@pytest.fixture(params=LINEMOD)
def model(request: pytest.FixtureRequest) -> assets.ObjectModel:
    return assets.load_object(request.param)


def welded(model: assets.ObjectModel) -> trimesh.Trimesh:
    """The surface without the seams of the texture."""
    places, index = np.unique(model.vertices, axis=0, return_inverse=True)
    return trimesh.Trimesh(places, index.reshape(-1)[model.faces], process=False)


def surface_colors(model: assets.ObjectModel, count: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Random surface points (N, 3) and the texture's colors there (N, 3)."""
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    points, face = trimesh.sample.sample_surface(mesh, count, seed=1)
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[face], points)
    uv = np.einsum("nk,nki->ni", weights, model.uv[model.faces[face]])
    return np.asarray(points), sample_texture(model.texture, uv)


def test_there_are_linemods_thirteen_in_order() -> None:
    assert tuple(LINEMOD) == assets.OBJECT_NAMES
    assert list(assets.load_objects()) == list(LINEMOD)


def test_sizes_are_linemods(model: assets.ObjectModel) -> None:
    obj_id, diameter, extents = LINEMOD[model.name]
    assert model.obj_id == obj_id
    assert 1000 * model.diameter == pytest.approx(diameter, rel=0.02)
    assert 1000 * pdist(welded(model).vertices).max() == pytest.approx(1000 * model.diameter)
    np.testing.assert_allclose(1000 * np.ptp(model.vertices, axis=0), extents, rtol=0.02)
    middle = (model.vertices.min(axis=0) + model.vertices.max(axis=0)) / 2
    np.testing.assert_allclose(middle, 0.0, atol=1e-5)


def test_meshes_are_watertight_and_small(model: assets.ObjectModel) -> None:
    mesh = welded(model)
    assert mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.volume > 0  # faces look outwards
    assert len(mesh.faces) <= 8000


def test_textures_cover_the_surface(model: assets.ObjectModel) -> None:
    assert model.uv.shape == (len(model.vertices), 2)
    assert model.uv.min() >= 0 and model.uv.max() <= 1
    corners = model.uv[model.faces].astype(float)
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.abs(np.linalg.det(sides)) / 2
    mesh = welded(model)
    density = areas.sum() * model.texture.shape[0] ** 2 / (1e6 * mesh.area)
    assert density > 0.2  # texels for each square millimeter
    _, colors = surface_colors(model)
    distinct = np.unique(np.round(5 * colors), axis=0)
    assert len(distinct) >= 3  # painted, not plain


def test_keypoints_are_farthest_points_and_the_center(model: assets.ObjectModel) -> None:
    assert model.keypoints.shape == (9, 3)
    np.testing.assert_array_equal(model.keypoints[8], 0.0)
    distances, _ = KDTree(model.vertices).query(model.keypoints[:8])
    assert distances.max() < 1e-9
    assert pdist(model.keypoints[:8]).min() > 0.1 * model.diameter
    assert np.linalg.norm(model.keypoints[0]) == np.linalg.norm(model.vertices, axis=1).max()


def test_points_are_spread_evenly(model: assets.ObjectModel) -> None:
    assert len(model.points) == 1000
    mesh = welded(model)
    nearest = KDTree(model.points).query(model.points, k=2)[0][:, 1]
    even = np.sqrt(mesh.area / len(model.points))
    assert nearest.min() > 0.3 * even and nearest.max() < 2.0 * even
    probes, _ = trimesh.sample.sample_surface(mesh, 3000, seed=2)
    assert KDTree(model.points).query(probes)[0].max() < 1.6 * even


def test_upright_comes_first_and_every_pose_rests_on_the_table(model: assets.ObjectModel) -> None:
    np.testing.assert_array_equal(model.stable_poses[0, :3, :3], np.eye(3))
    assert len(model.stable_poses) >= 2
    mass = welded(model).center_mass
    for T in model.stable_poses:
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
        placed = model.vertices @ T[:3, :3].T + T[:3, 3]
        assert placed[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        feet = placed[placed[:, 2] < 0.005 * model.diameter, :2]
        over = (T[:3, :3] @ mass + T[:3, 3])[:2]
        # Inside the polygon of the feet: in every direction some foot lies farther out.
        directions = np.deg2rad(np.arange(0, 360, 5))
        directions = np.stack([np.cos(directions), np.sin(directions)])
        assert ((feet - over) @ directions).max(axis=0).min() > 0


@pytest.mark.parametrize("name", ["eggbox", "glue"])
def test_symmetric_objects_are_unchanged_by_a_half_turn(name: str) -> None:
    model = assets.load_object(name)
    assert model.symmetric and model.symmetries.shape == (2, 4, 4)
    np.testing.assert_array_equal(model.symmetries[0], np.eye(4))
    np.testing.assert_array_equal(model.symmetries[1], np.diag([-1, -1, 1, 1]))
    rotated = model.vertices @ model.symmetries[1, :3, :3].T
    assert KDTree(model.vertices).query(rotated)[0].max() == 0.0

    points, colors = surface_colors(model, 60_000)
    rotated = points @ model.symmetries[1, :3, :3].T
    distances, twin = KDTree(points).query(rotated)
    assert distances.max() < 0.003
    assert np.abs(colors[twin] - colors).mean() < 0.02

    rotated_keypoints = model.keypoints @ model.symmetries[1, :3, :3].T
    assert KDTree(model.keypoints).query(rotated_keypoints)[0].max() < 1e-12


@pytest.mark.parametrize("name", sorted(set(LINEMOD) - {"eggbox", "glue"}))
def test_other_objects_are_not_symmetric(name: str) -> None:
    model = assets.load_object(name)
    assert not model.symmetric
    points, colors = surface_colors(model)
    tree = KDTree(points)
    for axis in range(3):
        flip = -np.ones(3)
        flip[axis] = 1.0
        distances, twin = tree.query(points * flip)
        moved = distances.mean() / model.diameter
        repainted = np.abs(colors[twin] - colors).mean()
        assert moved > 0.015 or repainted > 0.05


@pytest.mark.slow
def test_loading_is_cached_and_needs_no_learning_library() -> None:
    assert assets.load_object("duck") is assets.load_object("duck")
    code = (
        "import sys, two_view_pose.assets as a; a.load_objects();"
        "print(sorted({'torch', 'mujoco', 'stable_baselines3'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match=r"unknown object 'teapot'.*ape.*phone"):
        assets.load_object("teapot")
    with pytest.raises(FileNotFoundError, match=r"teapot\.ply"):
        assets.load_object("teapot.ply")
    with pytest.raises(ValueError, match="empty"):
        assets.load_objects([])
    with pytest.raises(ValueError, match="two objects have the name 'ape'"):
        assets.load_objects(["ape", "ape"])
