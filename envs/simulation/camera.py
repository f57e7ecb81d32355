"""Cameras that look at the table: sampling their poses, and conversion to OpenGL.

Everywhere else cameras are OpenCV's (x right, y down, z forward). OpenGL's (x right, y up, z
backward) exists in :func:`opencv_to_opengl` and :func:`frustum` alone.
"""

from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError
from ...core.geometry import invert, make_transform
from ...core.validation import require_range, require_within

_FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])


def opencv_to_opengl(T_cam_world: np.ndarray) -> np.ndarray:
    """Converts world to OpenCV camera (4, 4) to world to OpenGL camera, and back."""
    return _FLIP_YZ @ T_cam_world


def frustum(
    K: np.ndarray, height: int, width: int, near: float
) -> tuple[float, float, float, float]:
    """Returns (left, right, bottom, top) of OpenGL's frustum on its near plane, in meters.

    The center of the top-left pixel is (0, 0), so the image begins half a pixel before it.

    Args:
        K: camera matrix, (3, 3), pixels.
        height: of the image, pixels.
        width: of the image, pixels.
        near: distance of the near plane, meters.

    Raises:
        InputError: if K has skew, which OpenGL's frustum cannot express.
    """
    if abs(K[0, 1]) > 1e-9 * K[0, 0]:
        raise InputError(f"K must have no skew to be rendered, got K[0, 1] = {K[0, 1]}")
    left = near * (-0.5 - K[0, 2]) / K[0, 0]
    right = near * (width - 0.5 - K[0, 2]) / K[0, 0]
    top = near * (K[1, 2] + 0.5) / K[1, 1]
    bottom = near * (K[1, 2] + 0.5 - height) / K[1, 1]
    return left, right, bottom, top


def look_at(position: np.ndarray, target: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """Returns the pose of a camera at ``position`` whose optical axis goes through ``target``.

    Args:
        position: (3,) meters, world.
        target: (3,) meters, world.
        roll: rotation about the optical axis in radians; at 0 the image's rows are level.

    Returns:
        T_cam_world (4, 4).

    Raises:
        InputError: if the two points coincide.
    """
    forward = np.asarray(target, dtype=np.float64) - position
    length = np.linalg.norm(forward)
    if length < 1e-9:
        raise InputError(f"a camera at {position} cannot look at its own position")
    forward /= length
    right = np.cross(forward, (0.0, 0.0, 1.0))
    if np.linalg.norm(right) < 1e-9:  # straight up or down: any level direction will do
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = np.cos(roll), np.sin(roll)
    rotation = np.stack([cos * right + sin * down, cos * down - sin * right, forward], axis=1)
    return invert(make_transform(rotation, np.asarray(position, dtype=np.float64)))


def camera_center(T_cam_world: np.ndarray) -> np.ndarray:
    """Returns the centers (..., 3) of cameras (..., 4, 4) in the world, meters."""
    return invert(T_cam_world)[..., :3, 3]


def sphere_direction(azimuth: float, elevation: float) -> np.ndarray:
    """Returns the unit vector (3,) of an azimuth from +x towards +y and an elevation, radians."""
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def view_sphere_pose(
    center: np.ndarray, distance: float, azimuth: float, elevation: float, roll: float = 0.0
) -> np.ndarray:
    """Returns the pose of a camera on the sphere around ``center`` that looks at ``center``.

    Args:
        center: (3,) meters, world.
        distance: radius of the sphere in meters.
        azimuth: angle in the table's plane from +x towards +y, radians.
        elevation: angle above the table's plane, radians.
        roll: rotation about the optical axis, radians.

    Returns:
        T_cam_world (4, 4).
    """
    position = np.asarray(center) + distance * sphere_direction(azimuth, elevation)
    return look_at(position, center, roll)


@dataclass(frozen=True)
class CameraRange:
    """Range of camera poses around a point; all pairs are (min, max).

    Attributes:
        distance: meters.
        elevation: radians.
        azimuth: radians.
        roll: largest rotation about the optical axis to either side, radians.
        look_at_noise: largest offset of the optical axis from the point, as the tangent of the
            angle, vertically; horizontally 1.3 times as much, as images are wider than high.
    """

    distance: tuple[float, float] = (0.6, 1.4)
    elevation: tuple[float, float] = (np.deg2rad(7.0), np.deg2rad(82.0))
    azimuth: tuple[float, float] = (-np.pi, np.pi)
    roll: float = 0.0
    look_at_noise: float = 0.0

    def __post_init__(self) -> None:
        require_range(self, 0, np.inf, "distance")
        require_range(self, -np.inf, np.inf, "azimuth")
        require_range(self, -np.pi / 2, np.pi / 2, "elevation")
        require_within(self, 0, np.inf, "roll", "look_at_noise")
        if self.distance[0] == 0:
            raise InputError(f"distance must be positive, got {self.distance}")

    def sample(self, rng: np.random.Generator, center: np.ndarray) -> np.ndarray:
        """Samples T_cam_world (4, 4) of a camera around ``center`` (3,)."""
        distance = rng.uniform(*self.distance)
        azimuth = rng.uniform(*self.azimuth)
        elevation = rng.uniform(*self.elevation)
        roll = rng.uniform(-self.roll, self.roll)
        straight = view_sphere_pose(center, distance, azimuth, elevation)
        aim = self.sample_aim(rng, center, distance, straight)
        return look_at(camera_center(straight), aim, roll)

    def sample_aim(
        self, rng: np.random.Generator, center: np.ndarray, distance: float, straight: np.ndarray
    ) -> np.ndarray:
        """Samples the point (3,) to look at: ``center`` (3,) with look-at noise.

        The camera is ``distance`` meters away; ``straight`` is its T_cam_world (4, 4) if it looked
        at ``center``.
        """
        offset = self.look_at_noise * distance * rng.uniform((-1.3, -1.0), (1.3, 1.0))
        return center + offset @ straight[:2, :3]


CAMERA_RANGE = CameraRange()
"""Range of the camera around the object: 0.6 to 1.4 m, 7 to 82 degrees of elevation."""
