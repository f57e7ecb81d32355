"""Cameras, rigid transforms and crops, and the conventions of all other files.

Meters, radians, OpenCV camera frame (x right, y down, z forward), pixels with the center of the
top-left pixel at (0, 0). Every transform is named ``T_to_from`` and maps ``from`` coordinates to
``to`` coordinates.
"""

from dataclasses import dataclass

import numpy as np

from .errors import InputError

LINEMOD_IMAGE_SIZE = (480, 640)
"""Height and width in pixels of a LineMOD frame."""

LINEMOD_K = np.array([[572.4114, 0.0, 325.2611], [0.0, 573.57043, 242.04899], [0.0, 0.0, 1.0]])
"""LineMOD's camera matrix, (3, 3)."""
LINEMOD_K.setflags(write=False)


def _finite_matrix(matrix: np.ndarray, size: int, what: str, name: str) -> np.ndarray:
    out = np.asarray(matrix, dtype=np.float64)
    if out.shape != (size, size):
        raise InputError(f"{name} must be a {size}x{size} {what}, got shape {out.shape}")
    if not np.isfinite(out).all():
        raise InputError(f"{name} has NaN or infinite entries: {out.tolist()}")
    return out


def check_intrinsics(K: np.ndarray, name: str = "K") -> np.ndarray:
    """Returns ``K`` as float64 (3, 3).

    Raises:
        InputError: if it is not a finite 3x3 camera matrix with positive focal lengths and a last
            row of (0, 0, 1).
    """
    matrix = _finite_matrix(K, 3, "camera matrix", name)
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise InputError(
            f"{name} must have positive focal lengths, got {matrix[0, 0]} and {matrix[1, 1]}"
        )
    if not np.allclose(matrix[2], (0.0, 0.0, 1.0)):
        raise InputError(f"{name} must end in the row (0, 0, 1), got {matrix[2].tolist()}")
    return matrix


def check_rigid(T: np.ndarray, name: str = "T", tolerance: float = 1e-4) -> np.ndarray:
    """Returns ``T`` as float64 (4, 4).

    Raises:
        InputError: if it is not a finite 4x4 rigid transform (orthonormal rotation of determinant
            +1 within ``tolerance``, last row (0, 0, 0, 1)).
    """
    matrix = _finite_matrix(T, 4, "rigid transform", name)
    if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=tolerance):
        raise InputError(f"{name} must end in the row (0, 0, 0, 1), got {matrix[3].tolist()}")
    rotation, determinant = matrix[:3, :3], np.linalg.det(matrix[:3, :3])
    if determinant < 0 or not np.allclose(rotation @ rotation.T, np.eye(3), atol=tolerance):
        raise InputError(
            f"{name} is not rigid: its 3x3 part must be a rotation (orthonormal, determinant +1), "
            f"got determinant {determinant:.6f}"
        )
    return matrix


def check_image(image: np.ndarray, name: str = "image") -> np.ndarray:
    """Returns ``image`` if it is uint8 RGB of shape (H, W, 3).

    Raises:
        InputError: otherwise.
    """
    array = np.asarray(image)
    if array.ndim != 3 or array.shape[2] != 3 or array.size == 0 or array.dtype != np.uint8:
        raise InputError(
            f"{name} must be uint8 RGB of shape (height, width, 3), "
            f"got {array.dtype} of shape {array.shape}"
        )
    return array


def check_depth(depth: np.ndarray, shape: tuple[int, ...], name: str = "depth") -> np.ndarray:
    """Returns a depth map as float32 of ``shape`` (H, W), meters; NaN and infinity become 0.

    Raises:
        InputError: if it has another shape, or a negative entry.
    """
    array = np.asarray(depth, dtype=np.float32)
    if array.shape != tuple(shape):
        raise InputError(f"{name} must have the image's shape {tuple(shape)}, got {array.shape}")
    known = np.isfinite(array)
    if not known.all():  # what many sensors' drivers write where they see nothing
        array = np.where(known, array, np.float32(0))
    if array.min(initial=0.0) < 0:
        raise InputError(
            f"{name} must not be negative (meters along z, which points forward; 0 = unknown), "
            f"got {array.min():g}"
        )
    return array


@dataclass(frozen=True, eq=False)
class View:
    """One image with its camera: the input of an estimator.

    Attributes:
        image: RGB uint8, (H, W, 3).
        K: camera matrix in pixels, (3, 3).
        T_cam_world: world to OpenCV camera, (4, 4), meters. The world is any frame that the views
            of one estimate share.
        depth: depth map along z, (H, W) meters, 0 (or NaN or infinite) = unknown; None without a
            depth sensor. Only ``rgbd`` uses it.
    """

    image: np.ndarray
    K: np.ndarray
    T_cam_world: np.ndarray
    depth: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.depth is not None:
            object.__setattr__(self, "depth", check_depth(self.depth, np.shape(self.image)[:2]))
        object.__setattr__(self, "image", check_image(self.image))
        object.__setattr__(self, "K", check_intrinsics(self.K))
        object.__setattr__(self, "T_cam_world", check_rigid(self.T_cam_world, "T_cam_world"))


def invert(T: np.ndarray) -> np.ndarray:
    """Inverts rigid transforms (..., 4, 4)."""
    T = np.asarray(T, dtype=np.float64)
    out = np.zeros_like(T)
    rotation_t = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = rotation_t
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation_t, T[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def transform(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Applies T (4, 4) to points (..., 3)."""
    return points @ T[:3, :3].T + T[:3, 3]


def project(points: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Projects camera-frame points (..., 3) in meters to pixels (..., 2)."""
    uvw = points @ K.T
    return uvw[..., :2] / uvw[..., 2:3]


def make_transform(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Assembles a (4, 4) transform from a (3, 3) rotation and a (3,) translation."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation
    return T


def rotation_to_6d(rotation: np.ndarray) -> np.ndarray:
    """First two columns of a rotation, (6,): the continuous form of Zhou et al., CVPR 2019."""
    return np.concatenate([rotation[:3, 0], rotation[:3, 1]])


def crop_matrix(center: np.ndarray, side: float, size: int) -> np.ndarray:
    """The affine map (3, 3) from full-frame pixels to a square crop.

    Args:
        center: crop center in full-frame pixels, (2,).
        side: side of the crop in full-frame pixels.
        size: side of the crop in its own pixels.

    Returns:
        A such that ``A @ (u, v, 1)`` is the crop pixel; ``A @ K`` is the camera of the crop.
    """
    scale = size / side
    offset = (size - 1) / 2
    x, y = offset - scale * center[0], offset - scale * center[1]
    return np.array([[scale, 0.0, x], [0.0, scale, y], [0.0, 0.0, 1.0]])


def rotation_matrix_2d(angle: float, size: int) -> np.ndarray:
    """The affine map (3, 3) that rotates a crop of ``size`` pixels about its center, radians."""
    c, s = np.cos(angle), np.sin(angle)
    center = (size - 1) / 2
    x, y = center * (1 - c + s), center * (1 - c - s)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def grid_matrix(stride: int) -> np.ndarray:
    """The affine map (3, 3) from image pixels to those of a feature map with a stride."""
    offset = (1 - stride) / (2 * stride)
    return np.array([[1 / stride, 0, offset], [0, 1 / stride, offset], [0, 0, 1.0]])
