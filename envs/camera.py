"""Cameras that look at the table: placing them, and handing them to OpenGL.

Everywhere else cameras are OpenCV's (x right, y down, z forward). OpenGL's (x right, y up, z
backward) exists in :func:`opencv_to_opengl` and :func:`frustum` alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..pose_estimator.geometry import invert, make_transform

_FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])


def opencv_to_opengl(T_cam_world: np.ndarray) -> np.ndarray:
    """The same camera in OpenGL's convention; the map is its own inverse.

    Args:
        T_cam_world: world to OpenCV camera, (4, 4).

    Returns:
        World to OpenGL camera, (4, 4).
    """
    return _FLIP_YZ @ T_cam_world


def frustum(
    K: np.ndarray, height: int, width: int, near: float
) -> tuple[float, float, float, float]:
    """The sides (left, right, bottom, top) of OpenGL's frustum on its near plane, in metres.

    The centre of the top-left pixel is (0, 0), so the picture begins half a pixel before it.

    Args:
        K: camera matrix without skew, (3, 3), pixels.
        height: height of the picture in pixels.
        width: width of the picture in pixels.
        near: distance of the near plane, metres.

    Raises:
        ValueError: if K has skew, which OpenGL's frustum cannot express.
    """
    if abs(K[0, 1]) > 1e-9 * K[0, 0]:
        raise ValueError(f"K must have no skew to be rendered, got K[0, 1] = {K[0, 1]}")
    left = near * (-0.5 - K[0, 2]) / K[0, 0]
    right = near * (width - 0.5 - K[0, 2]) / K[0, 0]
    top = near * (K[1, 2] + 0.5) / K[1, 1]
    bottom = near * (K[1, 2] + 0.5 - height) / K[1, 1]
    return left, right, bottom, top


def look_at(position: np.ndarray, target: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """A camera at ``position`` whose optical axis goes through ``target``.

    Args:
        position: (3,) metres, world.
        target: (3,) metres, world.
        roll: turn about the optical axis in radians; at 0 the picture's rows are level.

    Returns:
        T_cam_world (4, 4).

    Raises:
        ValueError: if the two points coincide.
    """
    forward = np.asarray(target, dtype=np.float64) - position
    length = np.linalg.norm(forward)
    if length < 1e-9:
        raise ValueError(f"a camera at {position} cannot look at the point where it stands")
    forward /= length
    right = np.cross(forward, (0.0, 0.0, 1.0))
    if np.linalg.norm(right) < 1e-9:  # straight up or down: any level direction will do
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = np.cos(roll), np.sin(roll)
    rotation = np.stack([cos * right + sin * down, cos * down - sin * right, forward], axis=1)
    return invert(make_transform(rotation, np.asarray(position, dtype=np.float64)))


def view_sphere_pose(
    centre: np.ndarray, distance: float, azimuth: float, elevation: float, roll: float = 0.0
) -> np.ndarray:
    """A camera on the sphere around ``centre`` that looks at ``centre``.

    Args:
        centre: (3,) metres, world.
        distance: radius of the sphere in metres.
        azimuth: angle in the table's plane from +x towards +y, radians.
        elevation: angle above the table's plane, radians.
        roll: turn about the optical axis, radians.

    Returns:
        T_cam_world (4, 4).
    """
    direction = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    return look_at(np.asarray(centre) + distance * direction, centre, roll)


@dataclass(frozen=True)
class CameraRange:
    """Where a camera may stand around a point, and how carelessly it points there.

    Attributes:
        distance: nearest and farthest, metres.
        elevation: lowest and highest, radians.
        azimuth: from and to, radians.
        roll: largest turn about the optical axis to either side, radians.
        look_at_noise: how far the optical axis may pass the point, as the tangent of the angle,
            vertically; horizontally 1.3 times as far, as pictures are wider than high.
    """

    distance: tuple[float, float] = (0.6, 1.4)
    elevation: tuple[float, float] = (np.deg2rad(7.0), np.deg2rad(82.0))
    azimuth: tuple[float, float] = (-np.pi, np.pi)
    roll: float = 0.0
    look_at_noise: float = 0.0

    def __post_init__(self) -> None:
        for name in ("distance", "elevation", "azimuth"):
            low, high = getattr(self, name)
            if not low <= high:
                raise ValueError(f"{name} must be (lowest, highest), got {(low, high)}")
        if self.distance[0] <= 0:
            raise ValueError(f"distance must be positive, got {self.distance}")
        if abs(self.elevation[0]) > np.pi / 2 or abs(self.elevation[1]) > np.pi / 2:
            raise ValueError(f"elevation must be in radians within +-pi/2, got {self.elevation}")
        if self.roll < 0 or self.look_at_noise < 0:
            raise ValueError("roll and look_at_noise must not be negative")

    def sample(self, rng: np.random.Generator, centre: np.ndarray) -> np.ndarray:
        """Draws a camera at a distance, azimuth and elevation from ``centre``; T_cam_world."""
        distance = rng.uniform(*self.distance)
        azimuth = rng.uniform(*self.azimuth)
        elevation = rng.uniform(*self.elevation)
        roll = rng.uniform(-self.roll, self.roll)
        offset = self.look_at_noise * distance * rng.uniform((-1.3, -1.0), (1.3, 1.0))
        straight = view_sphere_pose(centre, distance, azimuth, elevation)
        position = -straight[:3, :3].T @ straight[:3, 3]
        return look_at(position, centre + offset @ straight[:2, :3], roll)


CAMERA_RANGE = CameraRange()
"""Where the camera may go around the object: 0.6 to 1.4 m, 7 to 82 degrees of elevation."""
