"""Camera intrinsics for images of another size than LineMOD's."""

from typing import Literal

import numpy as np

from ...core.errors import InputError
from ...core.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K


def scaled_intrinsics(size: tuple[int, int], fit: Literal["crop", "stretch"]) -> np.ndarray:
    """Returns LineMOD's camera matrix for another image size, (3, 3).

    Args:
        size: height and width, pixels.
        fit: for other aspect ratios than LineMOD's. ``"crop"`` keeps the largest centered window
            with square pixels; ``"stretch"`` keeps the field of view, so that fx and fy differ.

    Raises:
        InputError: if a side is < 1.
    """
    height, width = size
    if not (height >= 1 and width >= 1):
        raise InputError(f"resolution must be (height, width) >= 1, got {size}")
    full_height, full_width = LINEMOD_IMAGE_SIZE
    scale = np.array([width / full_width, height / full_height])
    if fit == "stretch":
        K = LINEMOD_K.copy()
        K[[0, 1], [0, 1]] *= scale
        K[:2, 2] = scale * (K[:2, 2] + 0.5) - 0.5  # pixel centers are whole numbers
        return K
    A = np.diag([scale.max(), scale.max(), 1.0])
    # The image centers coincide.
    A[0, 2] = (width - 1) / 2 - A[0, 0] * (full_width - 1) / 2
    A[1, 2] = (height - 1) / 2 - A[1, 1] * (full_height - 1) / 2
    return A @ LINEMOD_K
