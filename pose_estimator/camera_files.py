"""Reads camera matrices and relative poses from a user's files."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from warnings import warn

import numpy as np

from ..core.errors import InputError, InputWarning
from ..core.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K, check_intrinsics, check_rigid
from .input_files import read_content, read_matrix

ROTATION_TOLERANCE = 5e-2
"""Largest deviation from orthonormal of a rotation in a file, which is then made orthonormal."""

K_KEYS = ("K", "cam_K", "camera_matrix", "cameraMatrix", "intrinsic_matrix", "intrinsics")
_FOCAL = ("fx", "fy", "cx", "cy")
_SIZES = (("width", "height"), ("image_width", "image_height"))
_DISTORTIONS = (
    "distortion_coefficients",
    "dist_coeffs",
    "distCoeffs",
    "distortion",
    "dist",
    "D",
    "k1",
)
_POSE_KEYS = ("T_second_reference",)
_ROTATIONS = (("R", "t", 1.0), ("R", "T", 1.0), ("cam_R_ref2second", "cam_t_ref2second", 1e-3))
"""Keys of a rotation and a translation, and meters per unit of the latter."""


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """A camera matrix.

    Attributes:
        K: (3, 3), pixels.
        size: height and width of its images; None where they are not given.
    """

    K: np.ndarray
    size: tuple[int, int] | None = None


def parse_intrinsics(text: str) -> Intrinsics:
    """Reads the camera that ``--K`` gives: ``fx,fy,cx,cy``, ``linemod`` or a file.

    Files hold a 3x3 matrix, alone or under one of `K_KEYS`; ``fx``, ``fy``, ``cx`` and ``cy``, as
    BOP's ``camera.json``; BOP's ``scene_camera.json`` of one camera; or a projection matrix
    [K | 0]. OpenCV's and ROS' YAML and XML are read too.

    Raises:
        InputError: if it is malformed.
        FileNotFoundError: if it names a file that does not exist.
    """
    if text == "linemod":
        return Intrinsics(np.array(LINEMOD_K), LINEMOD_IMAGE_SIZE)
    parts = text.split(",")
    if len(parts) == 4:
        try:
            return Intrinsics(_of_four(list(map(float, parts)), "K"))
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"K must be four numbers fx,fy,cx,cy, got {text!r}") from error
    path = Path(text)
    if not path.exists():
        raise FileNotFoundError(
            f"K must be fx,fy,cx,cy, 'linemod' or a file with a 3x3 matrix; "
            f"{text!r} is neither and no such file exists"
        )
    content = read_content(path, "K")
    if not isinstance(content, Mapping):
        return Intrinsics(_matrix(read_matrix(path, "K", (), content), path))
    content = _one_camera(content, path)
    if any(np.any(_numbers(content[key])) for key in _DISTORTIONS if key in content):
        warn(
            f"K: {path} has lens distortion, which is not corrected: undistort the photographs "
            "first, such as with cv2.undistort",
            InputWarning,
            stacklevel=2,
        )
    size = None
    for names in _SIZES:
        sides = _numbers([content.get(name, 0) for name in names])
        if sides.shape == (2,) and (sides > 0).all():
            size = (round(sides[1]), round(sides[0]))
    if set(_FOCAL) <= set(content):
        four = _numbers([content[key] for key in _FOCAL])
        if four.shape != (4,):
            raise InputError(f"K: {path}: {', '.join(_FOCAL)} must be numbers")
        return Intrinsics(_of_four(four.tolist(), f"K: {path}"), size)
    return Intrinsics(_matrix(read_matrix(path, "K", K_KEYS, content), path), size)


def read_relative_pose(path: Path, name: str = "relative_pose") -> np.ndarray:
    """Reads the transform from the reference to the second camera, (4, 4), meters.

    Files hold a 4x4 or 3x4 matrix, alone or as ``T_second_reference``, or a rotation and a
    translation: ``R`` and ``t`` in meters, or BOP's ``cam_R_ref2second`` and ``cam_t_ref2second``
    in millimeters. A rounded rotation is made orthonormal.

    Raises:
        FileNotFoundError: if there is no such file.
        InputError: if it does not hold a rigid transform.
    """
    content = read_content(path, name)
    T: np.ndarray | None = None
    if isinstance(content, Mapping):
        for rotation, translation, unit in _ROTATIONS:
            if {rotation, translation} <= set(content):
                R, t = (read_matrix(path, name, (k,), content) for k in (rotation, translation))
                if R.size != 9 or t.size != 3:
                    raise InputError(
                        f"{name}: {path}: {rotation} and {translation} must be 3x3 and 3 numbers, "
                        f"got shapes {R.shape} and {t.shape}"
                    )
                T = np.column_stack([R.reshape(3, 3), unit * t.ravel()])
                break
    if T is None:
        T = read_matrix(path, name, _POSE_KEYS, content)
    if T.shape == (3, 4):
        T = np.vstack([T, [0.0, 0.0, 0.0, 1.0]])
    if T.shape == (4, 4) and np.allclose(T[:3, 3], 0) and not np.allclose(T[3, :3], 0):
        raise InputError(f"{name}: {path} is transposed: its translation is in the last row")
    T = check_rigid(T, f"{name}: {path}", ROTATION_TOLERANCE).copy()
    U, _, Vt = np.linalg.svd(T[:3, :3])
    T[:3, :3], T[3] = U @ Vt, (0.0, 0.0, 0.0, 1.0)
    return T


def _of_four(numbers: list[float], name: str) -> np.ndarray:
    fx, fy, cx, cy = numbers
    return check_intrinsics(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), name)


def _numbers(values: Any) -> np.ndarray:
    """The finite numbers of a field, or none where it holds something else."""
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.empty(0)
    return found if np.isfinite(found).all() else np.empty(0)


def _matrix(matrix: np.ndarray, path: Path) -> np.ndarray:
    """Returns a 3x3 matrix that was given as such, as four numbers, or in a larger matrix."""
    if matrix.size == 4 and 1 in (matrix.ndim, *matrix.shape):
        return _of_four(matrix.ravel().tolist(), f"K: {path}")
    if matrix.shape in ((3, 4), (4, 4)):
        if np.any(matrix[:3, 3]):
            raise InputError(
                f"K: {path} is a projection matrix K [R | t] with a translation; give K alone"
            )
        matrix = matrix[:3, :3]
    if matrix.shape == (3, 3) and np.allclose(matrix[:2, 2], 0) and (matrix[2, :2] > 0).all():
        raise InputError(f"K: {path} is transposed: MATLAB is column-major")
    return check_intrinsics(matrix, f"K: {path}")


def _one_camera(content: Mapping[str, Any], path: Path) -> Mapping[str, Any]:
    """Returns the camera of a ``scene_camera.json`` whose images have one; else the content."""
    cameras = list(content.values())
    if not cameras or not all(isinstance(c, Mapping) and "cam_K" in c for c in cameras):
        return content
    if any(camera["cam_K"] != cameras[0]["cam_K"] for camera in cameras):
        raise InputError(f"K: {path} holds different cameras; give that of the photographs alone")
    return dict(cameras[0])
