"""Data augmentation: mirrors scenes left to right, with their candidate views.

The best second view of a mirrored scene is the mirrored one. A mirrored object is not exactly the
object, but most are nearly symmetric, and doubling a thousand scenes helps more than this costs.
"""

import numpy as np

from ...core.errors import InputError

_TRANSLATION = np.array([-1, 1, 1], dtype=np.float32)
_ROTATION = np.array([1, -1, -1, -1, 1, 1], dtype=np.float32)
"""Signs of the first two columns of S R S with S = diag(-1, 1, 1)."""
_CAMERA = np.array([1, 1, 1, -1, 1, -1, 1], dtype=np.float32)
"""Signs of the distance, then sine and cosine of the elevation, of the azimuth, of the roll."""


class Mirror:
    """Mirrors observations and candidate views.

    Args:
        candidates: (N, 2) azimuth offset and elevation, radians.

    Attributes:
        slots: (N,) index of the mirrored view of each candidate.

    Raises:
        InputError: if the mirror image of a candidate is not a candidate.
    """

    def __init__(self, candidates: np.ndarray) -> None:
        mirrored = candidates * (-1, 1)
        distances = np.linalg.norm(mirrored[:, None] - candidates[None], axis=2)
        if distances.min(axis=1).max() > 1e-6:
            raise InputError("mirror needs candidate views that are symmetric in azimuth")
        self.slots = distances.argmin(axis=1)

    def observation(self, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Mirrors an observation or a batch of them (..., n)."""
        flipped = dict(observation)
        flipped["image"] = observation["image"][..., ::-1, :].copy()
        flipped["translation"] = observation["translation"] * _TRANSLATION
        flipped["rotation"] = observation["rotation"] * _ROTATION
        flipped["camera"] = observation["camera"] * _CAMERA
        return flipped
