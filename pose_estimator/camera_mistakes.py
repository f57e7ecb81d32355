"""Common mistakes in camera matrices and relative poses, with their probable causes."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from ..core.geometry import check_intrinsics

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenGL's camera (y up, z backward) to OpenCV's (y down, z forward)."""

WRITE_K = "write fx, 0, cx, 0, fy, cy, 0, 0, 1"

RESOLUTIONS = (0.25, 1 / 3, 0.5, 2 / 3, 0.75, 0.8, 1.25, 4 / 3, 1.5, 2.0, 3.0, 4.0)
"""Common ratios between the image sizes of one camera."""

MIDDLE = (0.25, 0.75)
"""Range of a plausible principal point, as fractions of the image's sides."""

_SAME_SCALE = (0.85, 1.18)
"""Range of the size of a principal point on the image's diagonal; 1 is the center."""


class CameraMistake(NamedTuple):
    """What is wrong with a camera matrix.

    Attributes:
        severity: ``error`` if no camera has such a matrix, ``warning`` if one may.
        problem: what is wrong.
        cause: what probably caused it; empty where unknown.
        remedy: what to do.
        detail: the numbers.
    """

    severity: Literal["error", "warning"]
    problem: str
    cause: str
    remedy: str
    detail: str


def scaled(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    """Returns a function that scales the translations of transforms (..., 4, 4)."""

    def scale(T: np.ndarray) -> np.ndarray:
        T = T.copy()
        T[..., :3, 3] *= factor
        return T

    return scale


def find_camera_mistake(K: np.ndarray, size: tuple[int, int] | None) -> CameraMistake | None:
    """Finds what is wrong with a camera matrix (3, 3) of images of ``size`` (H, W) or unknown."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    try:
        check_intrinsics(K)
    except ValueError:
        transposed = np.allclose(K[:2, 2], 0) and (K[2, :2] > 0).all()
        cause = "it is transposed: MATLAB is column-major" if transposed else ""
        detail = f"{K.round(2).tolist()}"
        return CameraMistake("error", "is not a valid camera matrix", cause, WRITE_K, detail)
    if size is None:
        return None
    height, width = size
    pixels = f"fx {fx:.6g}, fy {fy:.6g}, cx {cx:.6g}, cy {cy:.6g} for images of {width}x{height}"
    share = np.array([cx / width, cy / height])
    if (share < 0).any() or (share > 1 - 1e-9).any():
        problem = "the principal point is outside the image"
        return CameraMistake("error", problem, *_explain(K, size), pixels)
    if max(fx, fy) < 0.1 * width:
        remedy = "write focal lengths in pixels"
        cause = "they are in millimeters or fractions of the image's width"
        return CameraMistake("error", "the focal lengths are too short", cause, remedy, pixels)
    if not 0.8 < fx / fy < 1.25:
        cause = "the image was stretched, or the numbers are in another order"
        problem = "fx and fy differ by more than 25 %"
        return CameraMistake("warning", problem, cause, WRITE_K, pixels)
    far = (share < MIDDLE[0]).any() or (share > MIDDLE[1]).any()
    if far or _has_another_scale(share):
        problem = "the principal point is far from the image center"
        return CameraMistake("warning", problem, *_explain(K, size), pixels)
    return None


def _has_another_scale(share: np.ndarray) -> bool:
    """Whether a principal point, as fractions (2,) of the sides, is that of a scaled image."""
    low, high = _SAME_SCALE
    return abs(share[0] / share[1] - 1) < 0.1 and not low < share.sum() < high


def _explain(K: np.ndarray, size: tuple[int, int]) -> tuple[str, str]:
    """Returns the probable cause of an implausible principal point, and the remedy."""
    (fx, _, cx), (_, fy, cy) = K[:2] / np.array([[size[1]], [size[0]]])
    if max(abs(fx - 0.5), abs(fy - 0.5)) < 0.15 and abs(K[0, 2] / K[1, 2] - 1) < 0.1:
        return "focal lengths and principal point are swapped", WRITE_K
    scale = cx + cy
    near = min(cx, cy) > 0 and abs(cx / cy - 1) < 0.3 and not 0.7 < scale < 1.4
    if near or (min(cx, cy) > 0 and _has_another_scale(np.array([cx, cy]))):
        common = min(RESOLUTIONS, key=lambda ratio: abs(np.log(ratio / scale)))
        scale = common if abs(scale / common - 1) < 0.04 else scale
        return (
            f"it is the matrix of images {scale:.2g} times as large",
            f"divide fx, fy, cx and cy by {scale:.2g}, or use images of the calibrated size",
        )
    return (
        "another camera's matrix, numbers in another order, or cropped images",
        "calibrate again; after a crop subtract its corner from cx and cy",
    )
