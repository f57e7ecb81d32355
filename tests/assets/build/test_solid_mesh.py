"""Meshes of solids: closed, of the given size, and the same every time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from two_view_pose.assets.build import animals, solids
from two_view_pose.assets.build.size_fit import MAX_BEND
from two_view_pose.assets.build.solid_mesh import mesh_solid

UNIT_BOX = np.array([[-1.2] * 3, [1.2] * 3])


def white(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return np.ones_like(points)


@pytest.fixture(scope="module")
def lopsided() -> solids.Solid:
    """A rounded block with a horn: no symmetry, so a swapped axis cannot hide."""
    shape = solids.union(
        solids.box((0, 0, -0.3), (1.6, 1.2, 0.8), 0.1),
        solids.capsule((0.4, 0.2, 0), (0.7, 0.1, 0.9), 0.3, 0.15),
        smooth=0.1,
    )
    return solids.Solid(shape, white, UNIT_BOX, edge_length=0.06, faces=800)


@pytest.mark.slow
def test_sphere_meshes_to_a_sphere() -> None:
    ball = solids.Solid(solids.sphere((0, 0, 0), 1.0), white, UNIT_BOX, 0.08, faces=2000)
    mesh = mesh_solid(ball, (0.2, 0.2, 0.2), 0.2).mesh
    assert mesh.is_volume and mesh.body_count == 1 and mesh.euler_number == 2
    assert 1800 <= len(mesh.faces) <= 2100
    np.testing.assert_allclose(mesh.volume, 4 / 3 * np.pi * 0.1**3, rtol=0.01)
    np.testing.assert_allclose(mesh.area, 4 * np.pi * 0.1**2, rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("diameter", [0.098, 0.101])
def test_fit_meets_extents_and_diameter(lopsided: solids.Solid, diameter: float) -> None:
    extents = np.array([0.08, 0.05, 0.07])
    meshed = mesh_solid(lopsided, extents, diameter)
    assert meshed.mesh.is_volume and meshed.mesh.body_count == 1
    np.testing.assert_allclose(meshed.mesh.bounds, [-extents / 2, extents / 2], atol=1e-12)
    assert pdist(meshed.mesh.vertices).max() == pytest.approx(diameter, rel=0.01)
    assert abs(meshed.bend) <= MAX_BEND
    # Whatever the bend, going back to the solid lands on its surface, and the base stays flat.
    back = meshed.to_solid(meshed.mesh.vertices)
    assert np.abs(lopsided.sdf(back)).max() < 0.01
    base = meshed.mesh.vertices[back[:, 2] < -0.69]
    assert len(base) >= 4 and np.ptp(base[:, 2]) < 0.01 * extents[2]


@pytest.mark.slow
def test_same_solid_same_mesh(lopsided: solids.Solid) -> None:
    a, b = (mesh_solid(lopsided, (0.08, 0.05, 0.07), 0.1).mesh for _ in range(2))
    np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(a.faces, b.faces)


def test_unreachable_diameter_is_refused(lopsided: solids.Solid) -> None:
    with pytest.raises(ValueError, match="diameter_m"):
        mesh_solid(lopsided, (0.08, 0.05, 0.07), 0.2)


def test_pieces_and_tight_bounds_are_refused() -> None:
    apart = solids.union(solids.sphere((-0.6, 0, 0), 0.3), solids.sphere((0.6, 0, 0), 0.3))
    with pytest.raises(ValueError, match="one piece"):
        mesh_solid(solids.Solid(apart, white, UNIT_BOX, 0.1), (1, 1, 1), 1.0)
    large = solids.sphere((0, 0, 0.5), 1.0)
    with pytest.raises(ValueError, match="bounds"):
        mesh_solid(solids.Solid(large, white, UNIT_BOX, 0.1), (1, 1, 1), 1.0)


@pytest.mark.slow
def test_the_duck_stands_and_looks_like_one() -> None:
    """Size of LineMOD's duck, its weight over its base, yellow above all, the beak in front."""
    solid = animals.duck()
    meshed = mesh_solid(solid, (0.10443, 0.07741, 0.08570), 0.108999)
    mesh = meshed.mesh
    assert pdist(mesh.vertices).max() == pytest.approx(0.108999, rel=0.01)
    base = mesh.vertices[mesh.vertices[:, 2] < mesh.bounds[0, 2] + 0.001]
    assert (base.min(axis=0) < mesh.center_mass)[:2].all()
    assert (base.max(axis=0) > mesh.center_mass)[:2].all()
    rgb = solid.color(meshed.to_solid(mesh.triangles_center), mesh.face_normals)
    assert rgb.shape == (len(mesh.faces), 3) and rgb.min() >= 0 and rgb.max() <= 1
    yellow = (rgb[:, 0] > 0.9) & (rgb[:, 1] > 0.7) & (rgb[:, 2] < 0.3)
    orange = (rgb[:, 0] > 0.8) & (rgb[:, 1] < 0.5) & (rgb[:, 2] < 0.3)
    assert yellow.mean() > 0.5
    assert mesh.triangles_center[orange, 0].min() > 0.01
