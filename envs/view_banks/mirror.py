"""Scenes in a mirror: what is seen on the left is on the right, and so are the views to take.

The best second view of a mirrored scene is the mirrored one. The mirrored object is not quite an
object of the set, but most of them are nearly symmetric, and a policy that learns from a thousand
scenes gains more from seeing each twice than it loses.
"""

from __future__ import annotations

import numpy as np

from ...core.errors import InputError

_TRANSLATION = np.array([-1, 1, 1], dtype=np.float32)
_ROTATION = np.array([1, -1, -1, -1, 1, 1], dtype=np.float32)
"""Signs of S R S with S = diag(-1, 1, 1), its first two columns one after the other."""
_CAMERA = np.array([1, 1, 1, -1, 1, -1, 1], dtype=np.float32)
"""Signs of the distance, then sine and cosine of the elevation, of the azimuth, of the roll."""


class Mirror:
    """Mirrors observations left to right, and the numbers of candidate views with them.

    Args:
        candidates: (N, 2) azimuth offset and elevation, radians.

    Attributes:
        slots: (N,) number of the mirrored view of each.

    Raises:
        InputError: if a candidate has no mirrored one.
    """

    def __init__(self, candidates: np.ndarray) -> None:
        mirrored = candidates * (-1, 1)
        distances = np.linalg.norm(mirrored[:, None] - candidates[None], axis=2)
        if distances.min(axis=1).max() > 1e-6:
            raise InputError("mirror needs candidate views that are the same to the left and right")
        self.slots = distances.argmin(axis=1)

    def observation(self, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The observation of the mirrored scene; also of a batch of them (..., n)."""
        flipped = dict(observation)
        flipped["image"] = observation["image"][..., ::-1, :].copy()
        flipped["translation"] = observation["translation"] * _TRANSLATION
        flipped["rotation"] = observation["rotation"] * _ROTATION
        flipped["camera"] = observation["camera"] * _CAMERA
        return flipped
