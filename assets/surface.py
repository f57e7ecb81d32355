"""Properties of a surface: keypoints, evenly spaced points, diameter, stable poses."""

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, distance

from ..core.geometry import make_transform, transform

KEYPOINT_COUNT = 9
"""Eight on the surface and the center."""

POINT_COUNT = 1000
POINT_SEED = 0

_MAX_STABLE_POSES = 12
_MIN_PROBABILITY = 0.01


def farthest_points(points: np.ndarray, count: int, start: int) -> np.ndarray:
    """Farthest point sampling: indices (count,) into points (N, 3), the first being ``start``."""
    chosen = np.empty(count, dtype=int)
    nearest = np.full(len(points), np.inf)
    x, y, z = np.ascontiguousarray(points.T)  # contiguous columns are five times as fast
    index = start
    for k in range(count):
        chosen[k] = index
        squared = (x - x[index]) ** 2 + (y - y[index]) ** 2 + (z - z[index]) ** 2
        np.minimum(nearest, squared, out=nearest)
        index = int(nearest.argmax())
    return chosen


def keypoints(
    vertices: np.ndarray, center: np.ndarray, symmetries: np.ndarray | None = None
) -> np.ndarray:
    """PVNet's keypoints (9, 3): farthest point sampling over the surface, then the center.

    Peng et al., "PVNet: Pixel-wise Voting Network for 6DoF Pose Estimation", CVPR 2019, section
    3.1. The first keypoint is the vertex farthest from the center. For a symmetric object the
    images of each chosen vertex under the symmetries are keypoints too, so a symmetry only permutes
    the keypoints.

    Args:
        vertices: (V, 3).
        center: (3,), the ninth keypoint.
        symmetries: (S, 4, 4), identity first; used if S divides eight.
    """
    start = int(np.sum((vertices - center) ** 2, axis=1).argmax())
    count = KEYPOINT_COUNT - 1
    if symmetries is None or len(symmetries) == 1 or count % len(symmetries):
        return np.concatenate([vertices[farthest_points(vertices, count, start)], center[None]])
    images = vertices @ symmetries[1:, :3, :3].transpose(0, 2, 1) + symmetries[1:, None, :3, 3]
    travel = np.linalg.norm(images - vertices, axis=2).min(axis=0)
    # A vertex on the axis is its own image and would be the same keypoint twice.
    vertices = vertices[travel > 0.1 * np.linalg.norm(np.ptp(vertices, axis=0))]
    start = int(np.sum((vertices - center) ** 2, axis=1).argmax())
    chosen: list[np.ndarray] = []
    nearest = np.full(len(vertices), np.inf)
    index = start
    while len(chosen) < count:
        for S in symmetries:
            chosen.append(S[:3, :3] @ vertices[index] + S[:3, 3])
            nearest = np.minimum(nearest, np.sum((vertices - chosen[-1]) ** 2, axis=1))
        index = int(nearest.argmax())
    return np.stack([*chosen, center])


def even_points(mesh: trimesh.Trimesh, count: int = POINT_COUNT) -> np.ndarray:
    """Evenly spaced points (count, 3) on the surface, rounded to a micrometer."""
    dense, _ = trimesh.sample.sample_surface(mesh, 15 * count, seed=POINT_SEED)
    dense = np.asarray(dense)
    return np.round(dense[farthest_points(dense, count, 0)], 6)


def diameter(vertices: np.ndarray) -> float:
    """Largest distance between two vertices (V, 3)."""
    corners = vertices
    if np.linalg.matrix_rank(vertices - vertices[0], tol=1e-9) == 3:
        corners = vertices[ConvexHull(vertices).vertices]
    return float(max(distance.cdist(part, corners).max() for part in np.array_split(corners, 8)))


def center_of_mass(mesh: trimesh.Trimesh) -> np.ndarray:
    """Center of mass (3,); of the convex hull if the mesh is not closed."""
    solid = mesh if mesh.is_watertight and mesh.volume > 0 else mesh.convex_hull
    return np.asarray(solid.center_mass)


def support_margin(
    mesh: trimesh.Trimesh, tolerance: float, T_table_obj: np.ndarray | None = None
) -> float:
    """Distance (m) from the center of mass to the border of the support polygon, +z up.

    It is negative outside the polygon: the object tips over.

    Args:
        mesh: in the object frame.
        tolerance: vertices this close to the lowest one touch the ground (m).
        T_table_obj: (4, 4); None: identity.
    """
    T = np.eye(4) if T_table_obj is None else T_table_obj
    vertices, weight = transform(T, mesh.vertices), transform(T, center_of_mass(mesh))
    feet = vertices[vertices[:, 2] <= vertices[:, 2].min() + tolerance, :2]
    if len(feet) < 3 or np.linalg.matrix_rank(feet - feet[0], tol=1e-6) < 2:
        return -float("inf")
    planes = ConvexHull(feet).equations
    return -float(np.max(planes[:, :2] @ weight[:2] + planes[:, 2]))


def stable_poses(mesh: trimesh.Trimesh, max_tilt: float = 0.1) -> np.ndarray:
    """Poses T_table_obj (N, 4, 4) in which the object rests on z = 0.

    The first is upright (+z up) if the object can stand so; at most eleven others follow in order
    of decreasing probability (quasi-static probabilities of Goldberg et al., "Part pose
    statistics", IJRR 1999).

    Args:
        mesh: in the object frame, meters.
        max_tilt: maximum angle (rad) between +z and the vertical of an upright pose. Without any
            tilt the rotation is exactly the identity.
    """
    hull = mesh.convex_hull
    transforms, probabilities = trimesh.poses.compute_stable_poses(
        hull, center_mass=center_of_mass(mesh), seed=POINT_SEED
    )
    order = np.argsort(-np.asarray(probabilities), kind="stable")
    rotations = np.asarray(transforms)[order, :3, :3]
    likely = np.asarray(probabilities)[order] >= _MIN_PROBABILITY
    up = np.clip(rotations[:, 2, 2], -1.0, 1.0)
    standing = np.arccos(up) <= max_tilt
    chosen = [r for r, keep in zip(rotations, likely & ~standing, strict=True) if keep]
    if support_margin(mesh, tolerance=0.004 * float(np.linalg.norm(mesh.extents))) > 0:
        chosen.insert(0, np.eye(3))
    elif standing.any():
        chosen.insert(0, rotations[up.argmax()])
    elif not chosen:
        chosen = [rotations[0] if len(rotations) else np.eye(3)]
    return np.stack([_on_the_table(r, mesh.vertices) for r in chosen[:_MAX_STABLE_POSES]])


def _on_the_table(rotation: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """The pose with the center over the table's origin and the lowest point at z = 0."""
    rotated = vertices @ rotation.T
    low, high = rotated.min(axis=0), rotated.max(axis=0)
    return make_transform(rotation, -np.array([*(low + high)[:2] / 2, low[2]]))
