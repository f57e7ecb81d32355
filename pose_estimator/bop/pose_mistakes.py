"""Common mistakes in written poses and camera matrices, each with its correction."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...core.geometry import invert, make_transform
from ..camera_mistakes import OPENGL, RESOLUTIONS, WRITE_K

ORIGINS = (0.35, 0.65)
"""Range of a corrected principal point, as fractions of the image's sides."""


@dataclass(frozen=True, eq=False)
class Correction:
    """One hypothesis about a wrong pose or camera matrix.

    Attributes:
        name: short, the same for all poses.
        field: the wrong field of scene_gt.json, or ``cam_K`` of scene_camera.json.
        cause: what went wrong.
        remedy: what to do.
        T_cam_obj: the corrected pose, (4, 4), meters.
        K: the corrected camera matrix, (3, 3).
    """

    name: str
    field: str
    cause: str
    remedy: str
    T_cam_obj: np.ndarray
    K: np.ndarray


def _reordered(order: tuple[int, int, int, int]) -> Callable[[np.ndarray], np.ndarray]:
    """Corrects a quaternion (x, y, z, w) that was read in another order."""

    def correct(T: np.ndarray) -> np.ndarray:
        quaternion = Rotation.from_matrix(T[:3, :3]).as_quat()[list(order)]
        return make_transform(Rotation.from_quat(quaternion).as_matrix(), T[:3, 3])

    return correct


_POSES: tuple[tuple[str, str, str, str, Callable[[np.ndarray], np.ndarray]], ...] = (
    (
        "opengl", "cam_R_m2c, cam_t_m2c",
        "the camera's axes are OpenGL's or Blender's (y up, z backward); BOP has OpenCV's",
        "multiply poses by diag(1, -1, -1, 1) from the left", lambda T: OPENGL @ T,
    ),
    (
        "inverse", "cam_R_m2c, cam_t_m2c",
        "the pose is inverted: it maps camera to object; BOP has object to camera (m2c)",
        "invert poses: R transposed, and -R transposed times t", invert,
    ),
    (
        "inverse of opengl", "cam_R_m2c, cam_t_m2c",
        "the pose is that of an OpenGL camera in the object's frame (camera to object)",
        "invert poses, then multiply them by diag(1, -1, -1, 1) from the left",
        lambda T: OPENGL @ invert(T),
    ),
    (
        "transposed", "cam_R_m2c",
        "the rotation is transposed: written column-major, or of the inverse",
        "transpose cam_R_m2c: BOP has it row-major",
        lambda T: make_transform(T[:3, :3].T, T[:3, 3]),
    ),
    (
        "quaternion wxyz", "cam_R_m2c",
        "the rotation is of a quaternion in the order w, x, y, z that was read as x, y, z, w",
        "rebuild it: SciPy's from_quat takes x, y, z, w (or scalar_first=True)",
        _reordered((1, 2, 3, 0)),
    ),
    (
        "quaternion xyzw", "cam_R_m2c",
        "the rotation is of a quaternion in the order x, y, z, w that was read as w, x, y, z",
        "rebuild it: put w first where the library wants it first", _reordered((3, 0, 1, 2)),
    ),
)  # fmt: skip

_UNITS = (
    ("", "", "", 1.0),
    ("meters", "cam_t_m2c is in meters; BOP has millimeters", "multiply cam_t_m2c by 1000", 1e3),
    (
        "centimeters", "cam_t_m2c is in centimeters; BOP has millimeters",
        "multiply cam_t_m2c by 10", 10.0,
    ),
    (
        "twice millimeters", "cam_t_m2c was scaled by 1000 twice",
        "divide cam_t_m2c by 1000", 1e-3,
    ),
)  # fmt: skip


def corrections(T: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> Iterator[Correction]:
    """Yields all corrections of a pose and its camera, simple ones first.

    Args:
        T: object to camera as written, (4, 4), meters.
        K: camera matrix as written, (3, 3).
        size: height and width of the image.
    """
    yield from pose_corrections(T, K)
    for name, cause, remedy, matrix in _cameras(K, size):
        yield Correction(name, "cam_K", cause, remedy, T, matrix)


def pose_corrections(T: np.ndarray, K: np.ndarray) -> Iterator[Correction]:
    """Yields the corrections of a pose alone; arguments as in `corrections`."""
    for unit, cause, remedy, factor in _UNITS:
        scaled = T.copy()
        scaled[:3, 3] *= factor
        if unit:
            yield Correction(unit, "cam_t_m2c", cause, remedy, scaled, K)
        for name, field, reason, cure, correct in _POSES:
            yield Correction(
                f"{unit} {name}".strip(),
                field,
                f"{cause}; and {reason}" if unit else reason,
                f"{remedy}; {cure}" if unit else cure,
                correct(scaled),
                K,
            )


def _cameras(K: np.ndarray, size: tuple[int, int]) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Yields corrections of a camera matrix with the principal point near the image center."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    found = [
        ("K swapped", "focal lengths and principal point are swapped", WRITE_K, (cx, cy, fx, fy)),
        ("K upright", "cx and cy are swapped, as after a rotation by 90 degrees", WRITE_K,
         (fy, fx, cy, cx)),
    ]  # fmt: skip
    found += [
        (
            f"K times {factor:.3g}",
            f"the camera matrix is that of images {1 / factor:.3g} times as large",
            f"multiply fx, fy, cx and cy by {factor:.3g}",
            (factor * fx, factor * fy, factor * cx, factor * cy),
        )
        for factor in RESOLUTIONS
    ]
    height, width = size
    for name, cause, remedy, (a, b, c, d) in found:
        middle = all(ORIGINS[0] < x < ORIGINS[1] for x in (c / width, d / height))
        if middle and min(a, b) > 0:
            yield name, cause, remedy, np.array([[a, 0, c], [0, b, d], [0, 0, 1.0]])
