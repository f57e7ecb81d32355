"""The nearest of a set of points to the same points moved: what ADD-S asks, again and again.

Distances do not change under a rigid motion, so one index of the points serves every pose. FLANN's
single k-d tree (exact, in OpenCV) finds the neighbors about twice as quickly as SciPy's, but in
single precision; the distances to what it found are then taken in double precision. It can prefer a
neighbor that is farther by the rounding, 1e-8 of the points' extent; few do, and the mean of
thousands of distances moves by some 1e-12 m at most. Motions that carry the points so far away that
their coordinates would be rounded coarsely are left to SciPy.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import cKDTree

_LEAF = 8
"""Points in a leaf of FLANN's tree; 6 to 10 were fastest for 1,000 and 5,000 points."""

_FAR_LEAF = 32
"""Points in a leaf of SciPy's tree, where everything is far away."""

_SINGLE_KD_TREE, _UNLIMITED = 4, -1
"""FLANN_INDEX_KDTREE_SINGLE and FLANN_CHECKS_UNLIMITED, which OpenCV's Python does not name."""

_FAR = 1.5
"""Motion of the points' center, in radii of the points, from which on it is far."""


class NearestPoints:
    """An index of points.

    Args:
        points: (P, 3) with P > 0, meters.

    Raises:
        InputError: if a point is not finite.
    """

    def __init__(self, points: np.ndarray) -> None:
        points = np.asarray(points, dtype=np.float64)
        self._center = points.mean(axis=0)
        centered = points - self._center
        self._tree = cKDTree(centered, _FAR_LEAF, balanced_tree=False)
        # In the order of a tree, so that queries that follow each other walk the same branches.
        self._points = centered[self._tree.indices]
        self._radius = float(np.linalg.norm(centered, axis=1).max())
        single = self._points.astype(np.float32)
        config = {"algorithm": _SINGLE_KD_TREE, "leaf_max_size": _LEAF}
        self._index = cv2.flann_Index(single, config)  # type: ignore[attr-defined]
        self._kept = single  # whose memory the index reads

    def mean_distance(self, T: np.ndarray) -> float:
        """Mean distance in meters from each of the points, moved by T, to the nearest unmoved.

        Args:
            T: rigid motion, (4, 4).
        """
        R = T[:3, :3]
        shift = R @ self._center + T[:3, 3] - self._center
        moved = self._points @ R.T
        moved += shift
        if not np.linalg.norm(shift) <= _FAR * self._radius:
            return float(self._tree.query(moved)[0].mean())
        found, _ = self._index.knnSearch(moved.astype(np.float32), 1, params={"checks": _UNLIMITED})
        moved -= self._points[found[:, 0]]
        return float(np.sqrt(np.einsum("ij,ij->i", moved, moved)).mean())
