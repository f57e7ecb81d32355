"""Unwrapping and baking against closed forms."""

import numpy as np
import pytest
import trimesh
from two_view_pose.assets.texture import bake, rasterize, sample_texture, unwrap


def rainbow(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """A smooth color function of place."""
    return 0.5 + 0.45 * np.sin(3.0 * points + np.array([0.0, 1.0, 2.0]))


def test_baked_colors_match_the_function() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces, uv = unwrap(mesh)
    texture = bake(vertices, faces, uv, rainbow)
    surface = trimesh.Trimesh(vertices, faces, process=False)
    points, face = trimesh.sample.sample_surface(surface, 5000, seed=0)
    weights = trimesh.triangles.points_to_barycentric(surface.triangles[face], points)
    colors = sample_texture(texture, np.einsum("nk,nki->ni", weights, uv[faces[face]]))
    error = np.abs(colors - rainbow(np.asarray(points), np.zeros_like(points)))
    assert error.mean() < 0.01
    assert error.max() < 0.1  # also at the borders of charts, where the padding is looked at


def test_unwrapping_keeps_the_surface() -> None:
    mesh = trimesh.creation.cylinder(radius=0.03, height=0.1, sections=24)
    vertices, faces, uv = unwrap(mesh)
    np.testing.assert_allclose(vertices[faces], mesh.triangles, atol=1e-12)
    assert uv.min() >= 0 and uv.max() <= 1
    assert np.unique(np.round(np.hstack([vertices, uv]), 9), axis=0).shape[0] == len(vertices)


def test_charts_do_not_overlap() -> None:
    _, faces, uv = unwrap(trimesh.creation.box(extents=(0.1, 0.2, 0.05)))
    rows, columns, face, weights = rasterize(uv[faces].astype(float), 512)
    inner = weights.min(axis=1) > 0.02
    places = np.stack([rows, columns], axis=1)[inner]
    assert len(np.unique(places, axis=0)) == len(places)
    assert set(face.tolist()) == set(range(len(faces)))


def test_rasterized_texels_lie_in_their_triangle() -> None:
    rng = np.random.default_rng(0)
    triangles = rng.random((20, 3, 2))
    rows, columns, face, weights = rasterize(triangles, 64)
    centers = np.stack([(columns + 0.5) / 64, 1 - (rows + 0.5) / 64], axis=1)
    np.testing.assert_allclose(
        np.einsum("nk,nki->ni", weights, triangles[face]), centers, atol=1e-12
    )
    areas = np.abs(np.linalg.det(triangles[:, 1:] - triangles[:, :1])) / 2
    counts = np.bincount(face, minlength=20) / 64**2
    np.testing.assert_allclose(counts, areas, atol=0.01)


def test_texture_row_zero_is_at_the_top() -> None:
    texture = np.zeros((4, 4, 3), dtype=np.uint8)
    texture[0, :, 0] = 255
    np.testing.assert_allclose(sample_texture(texture, np.array([[0.5, 0.875]])), [[1, 0, 0]])
    np.testing.assert_allclose(sample_texture(texture, np.array([[0.5, 0.125]])), [[0, 0, 0]])


def test_wrong_color_functions() -> None:
    vertices, faces, uv = unwrap(trimesh.creation.box())
    with pytest.raises(ValueError, match="one RGB color per point"):
        bake(vertices, faces, uv, lambda points, normals: points[:, :2])
    with pytest.raises(ValueError, match="covers no texel"):
        bake(vertices, faces, np.zeros_like(uv), rainbow)
