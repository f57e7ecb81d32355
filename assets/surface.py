"""Properties of a surface: keypoints, evenly spaced points, diameter, stable poses."""

import fast_simplification
import numpy as np
import trimesh
from scipy.spatial import ConvexHull, KDTree, distance

from ..core.geometry import make_transform, transform

KEYPOINT_COUNT = 9
"""Eight on the surface and the center."""

POINT_COUNT = 1000
POINT_SEED = 0

_MAX_STABLE_POSES = 12
_MIN_PROBABILITY = 0.01
_NEGLIGIBLE = 0.001
"""Probability of a pose that is not even looked at: a ball has thousands of these."""

_FEW_CORNERS = 4000
"""Hull vertices up to which all pairs are measured."""

_AT_ONCE = 1_000_000
"""Pairs in memory."""

_MANY_PAIRS = 100_000_000
"""Pairs that are slower to look up than all are to measure."""


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


def simplified(
    vertices: np.ndarray,
    faces: np.ndarray,
    count: int,
    aggressiveness: float,
    size: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Thins a mesh to at most about ``count`` faces by quadric edge collapse.

    Garland and Heckbert, "Surface simplification using quadric error metrics", SIGGRAPH 1997.
    Vertices at the same place, which textures double at their seams, become one before: the borders
    that they make would be eaten away.

    Args:
        vertices: (V, 3) in any unit.
        faces: (F, 3).
        count: of faces; a mesh that has no more is only merged.
        aggressiveness: of the collapse; larger is faster, and coarser where it is flat.
        size: length that counts as one in the collapse's thresholds; None: the largest extent.

    Returns:
        Vertices (V', 3) and faces (F', 3).
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if len(mesh.faces) <= count:
        return np.asarray(mesh.vertices), np.asarray(mesh.faces)
    size = size or float(mesh.extents.max())
    thinned, triangles = fast_simplification.simplify(
        np.ascontiguousarray(mesh.vertices / size),
        np.ascontiguousarray(mesh.faces),
        target_count=count,
        agg=aggressiveness,
    )
    return np.asarray(thinned, dtype=np.float64) * size, np.asarray(triangles)


def diameter(vertices: np.ndarray) -> float:
    """Largest distance between two vertices (V, 3), exactly, in bounded memory."""
    corners = vertices
    if np.linalg.matrix_rank(vertices - vertices[0], tol=1e-9) == 3:
        corners = vertices[ConvexHull(vertices).vertices]
    if len(corners) <= _FEW_CORNERS:
        parts = np.array_split(corners, 8)
        return float(max(distance.cdist(part, corners).max() for part in parts))
    return _diameter_of_many(corners)


def _diameter_of_many(corners: np.ndarray) -> float:
    """As `diameter`, for hulls of balls and other smooth bodies.

    With L the length of some pair and r the distance of the farthest corner from a center c, the
    parallelogram law gives for every longer pair p, q (relative to c)
    |q + p|^2 < 2 |p|^2 + 2 r^2 - L^2: q is near the antipode of p, or there is none.
    """
    start, length, ends = 0, -1.0, corners[:1]
    for _ in range(20):  # from a corner to the farthest one until that finds nothing longer
        reach = np.linalg.norm(corners - corners[start], axis=1)
        far = int(reach.argmax())
        if reach[far] <= length:
            break
        length, ends, start = float(reach[far]), corners[[start, far]], far
    centers = [ends.mean(axis=0), (corners.min(axis=0) + corners.max(axis=0)) / 2]
    center = min(centers, key=lambda c: float(np.linalg.norm(corners - c, axis=1).max()))
    placed = corners - center
    squared = np.sum(placed**2, axis=1)
    # Numbers of this size are rounded to 16 digits; a little more is looked at.
    around = 2 * squared + 2 * squared.max() - length**2 + 1e-12 * length**2
    candidates = placed[around > 0]
    radii = np.sqrt(around[around > 0])
    tree = KDTree(placed)
    found = tree.query_ball_point(-candidates, radii, return_length=True)
    if found.sum(dtype=np.int64) > _MANY_PAIRS:  # bodies that are far from any symmetry
        parts = np.array_split(candidates, 1 + len(candidates) * len(placed) // _AT_ONCE)
        return float(max(distance.cdist(part, placed).max() for part in parts))
    for some in _portions(found):
        near = tree.query_ball_point(-candidates[some], radii[some])
        counts = [len(indices) for indices in near]
        if not sum(counts):
            continue
        others = placed[np.concatenate([np.asarray(i, dtype=np.int64) for i in near])]
        offsets = others - np.repeat(candidates[some], counts, axis=0)
        length = max(length, float(np.sqrt(np.sum(offsets**2, axis=1).max())))
    return length


def _portions(counts: np.ndarray) -> list[np.ndarray]:
    """Splits indices so that the counts of each portion add to about ``_AT_ONCE``."""
    sums = np.cumsum(counts, dtype=np.int64)
    total = int(sums[-1]) if len(sums) else 0
    bounds = np.searchsorted(sums, np.arange(_AT_ONCE, total, _AT_ONCE))
    return np.split(np.arange(len(counts)), bounds)


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
        hull, center_mass=center_of_mass(mesh), threshold=_NEGLIGIBLE, seed=POINT_SEED
    )
    if not len(transforms):
        transforms, probabilities = np.eye(4)[None], np.zeros(1)
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
