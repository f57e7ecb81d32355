"""Mean distance from moved points to their nearest neighbors in the unmoved ones, for ADD-S.

FLANN's single k-d tree (exact, in OpenCV) finds neighbors about twice as fast as SciPy's, but in
single precision; the distances to them are then computed in double precision. Rounding (1e-8 of the
extent) can select another neighbor, which moves the mean of thousands by 1e-12 m at most. For large
motions, whose coordinates would be rounded coarsely, SciPy is used.
"""

import cv2
import numpy as np
from scipy.spatial import cKDTree

_SINGLE_KD_TREE, _UNLIMITED = 4, -1
"""FLANN_INDEX_KDTREE_SINGLE and FLANN_CHECKS_UNLIMITED, which OpenCV's Python does not name."""

_MAX_SHIFT = 1.5
"""Largest motion of the points' center for FLANN, in radii of the points."""


class NearestPoints:
    """A nearest-neighbor index of points.

    Args:
        points: (P, 3) with P > 0, meters.

    Raises:
        InputError: if a point is not finite.
    """

    def __init__(self, points: np.ndarray) -> None:
        points = np.asarray(points, dtype=np.float64)
        self._center = points.mean(axis=0)
        centered = points - self._center
        self._tree = cKDTree(centered, leafsize=32, balanced_tree=False)
        # In the order of the tree: successive queries walk the same branches, which is faster.
        self._points = centered[self._tree.indices]
        self._radius = float(np.linalg.norm(centered, axis=1).max())
        single = self._points.astype(np.float32)
        # Leaves of 6 to 10 points were fastest for 1,000 and 5,000 points.
        config = {"algorithm": _SINGLE_KD_TREE, "leaf_max_size": 8}
        self._index = cv2.flann_Index(single, config)  # type: ignore[attr-defined]
        self._single = single  # the index reads its memory

    def mean_distance(self, T: np.ndarray) -> float:
        """Returns the mean distance (m) from the points, moved by T (4, 4), to the unmoved ones."""
        R = T[:3, :3]
        shift = R @ self._center + T[:3, 3] - self._center
        moved = self._points @ R.T
        moved += shift
        if not np.linalg.norm(shift) <= _MAX_SHIFT * self._radius:
            return float(self._tree.query(moved)[0].mean())
        found, _ = self._index.knnSearch(moved.astype(np.float32), 1, params={"checks": _UNLIMITED})
        moved -= self._points[found[:, 0]]
        return float(np.sqrt(np.einsum("ij,ij->i", moved, moved)).mean())
