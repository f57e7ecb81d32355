"""Objects that half a turn about z does not change, exactly in shape and in texture.

Meshing and decimation know nothing of symmetry, and a network would see every triangle that
differs. So one quarter of the mesh is kept and mirrored twice, and all four quarters share one
part of the texture; two mirrors make the half turn.
"""

from __future__ import annotations

import numpy as np
import trimesh

HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""180 degrees about z, (4, 4)."""

_MIRRORS = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [1.0, -1.0, 1.0]])


def quarter(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The part of a mesh with x >= 0 and y >= 0, open along the two cuts."""
    vertices = np.array(mesh.vertices)
    near = np.abs(vertices[:, :2]) < 2e-3 * float(mesh.extents.max())
    vertices[:, :2][near] = 0.0  # a vertex close to a cut would leave slivers behind
    mesh = trimesh.Trimesh(vertices, mesh.faces, process=False)
    for axis in range(2):
        mesh = trimesh.intersections.slice_mesh_plane(mesh, np.eye(3)[axis], np.zeros(3))
        vertices = np.array(mesh.vertices)
        vertices[np.abs(vertices[:, axis]) < 1e-9, axis] = 0.0
        mesh = trimesh.Trimesh(vertices, mesh.faces)
        mesh.update_faces(trimesh.triangles.nondegenerate(mesh.triangles, height=0.0))
    return mesh


def mirror_quarter(
    vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mirrors an unwrapped quarter at the planes x = 0 and y = 0.

    Args:
        vertices: (V, 3) with x, y >= 0.
        faces: (F, 3).
        uv: (V, 2); the copies use the same coordinates.

    Returns:
        Vertices, faces and uv of the closed mesh; copies that fall together are welded.
    """
    all_vertices = np.concatenate([vertices * mirror for mirror in _MIRRORS]) + 0.0  # no -0.0
    all_faces = np.concatenate(
        [
            (faces if mirror.prod() > 0 else faces[:, ::-1]) + k * len(vertices)
            for k, mirror in enumerate(_MIRRORS)
        ]
    )
    all_uv = np.tile(uv, (len(_MIRRORS), 1))
    rows = np.concatenate([all_vertices, all_uv], axis=1)
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    welded = inverse.reshape(-1)[all_faces].astype(np.int32)
    return all_vertices[first], welded, all_uv[first]
