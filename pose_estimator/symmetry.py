"""Symmetric objects: one canonical pose for each appearance, and permuted keypoints."""

import numpy as np

_CANONICAL_DIRECTION = np.array([0.45, 0.89, 0.0])
"""In the object's frame; in the canonical pose it points towards the camera."""

_CANONICAL_RIGHT = np.array([-0.89, 0.45, 0.0])
"""In the object's frame; in a sphere's canonical pose it points to the right of the image too."""

_MAX_CYLINDER = 144
"""Only a sphere has more symmetry transforms: those of a cylinder leave no spin to choose."""


def canonical_pose(T_cam_obj: np.ndarray, symmetries: np.ndarray) -> np.ndarray:
    """Returns the symmetry-equivalent pose whose fixed side faces the camera most.

    Poses that differ by a symmetry look alike, so a network needs one label for all of them.

    Args:
        T_cam_obj: (4, 4).
        symmetries: (S, 4, 4), identity first.

    Returns:
        ``T_cam_obj @ symmetries[s]`` for the best s, (4, 4).
    """
    if len(symmetries) == 1:
        return T_cam_obj
    equivalents = T_cam_obj @ symmetries
    towards_camera = -np.einsum("sji,sj->si", equivalents[:, :3, :3], equivalents[:, :3, 3])
    facing = towards_camera @ _CANONICAL_DIRECTION
    if len(symmetries) > _MAX_CYLINDER:
        facing = facing / np.linalg.norm(T_cam_obj[:3, 3])
        facing += equivalents[:, 0, :3] @ _CANONICAL_RIGHT
    return equivalents[int(np.argmax(facing))]


def keypoint_permutations(
    keypoints: np.ndarray, symmetries: np.ndarray, tolerance: float = 1e-4
) -> np.ndarray:
    """Returns how the symmetries permute the keypoints.

    Args:
        keypoints: (9, 3).
        symmetries: (S, 4, 4), identity first.
        tolerance: meters.

    Returns:
        (P, 9) indices, the identity first: keypoint i of ``T @ symmetries[p]`` is keypoint
        ``permutation[p, i]`` of ``T``. Symmetries under which the set of keypoints is not closed
        are left out.
    """
    permutations = []
    for S in symmetries:
        moved = keypoints @ S[:3, :3].T + S[:3, 3]
        distance = np.linalg.norm(moved[:, None] - keypoints[None], axis=-1)
        nearest = distance.argmin(1)
        if distance.min(1).max() < tolerance and len(set(nearest)) == len(keypoints):
            permutations.append(nearest)
    return np.array(permutations)
