"""One pose for each appearance of a symmetric object."""

from __future__ import annotations

import numpy as np

_SEEN_BEST = np.array([0.45, 0.89, 0.0])
"""Direction in the object's frame, from which the canonical pose is seen."""


def canonical_pose(T_cam_obj: np.ndarray, symmetries: np.ndarray) -> np.ndarray:
    """Chooses the equivalent pose that the camera sees best.

    Two poses that differ by a symmetry look alike, and no network can tell them apart. Of all
    equivalents this takes the one whose fixed side faces the camera most.

    Args:
        T_cam_obj: (4, 4).
        symmetries: (S, 4, 4), identity first.

    Returns:
        (4, 4), ``T_cam_obj @ symmetries[s]`` for the best s.
    """
    if len(symmetries) == 1:
        return T_cam_obj
    equivalents = T_cam_obj @ symmetries
    towards_camera = -np.einsum("sji,sj->si", equivalents[:, :3, :3], equivalents[:, :3, 3])
    return equivalents[int(np.argmax(towards_camera @ _SEEN_BEST))]


def keypoint_permutations(
    keypoints: np.ndarray, symmetries: np.ndarray, tolerance: float = 1e-4
) -> np.ndarray:
    """How the symmetries permute the keypoints.

    Args:
        keypoints: (9, 3).
        symmetries: (S, 4, 4), identity first.
        tolerance: meters.

    Returns:
        (P, 9) index arrays, the identity first: keypoint i of ``T @ symmetries[p]`` lies where
        keypoint ``permutation[p, i]`` of ``T`` lies. Symmetries under which the set of keypoints is
        not closed are left out.
    """
    permutations = []
    for S in symmetries:
        moved = keypoints @ S[:3, :3].T + S[:3, 3]
        distance = np.linalg.norm(moved[:, None] - keypoints[None], axis=-1)
        nearest = distance.argmin(1)
        if distance.min(1).max() < tolerance and len(set(nearest)) == len(keypoints):
            permutations.append(nearest)
    return np.array(permutations)
