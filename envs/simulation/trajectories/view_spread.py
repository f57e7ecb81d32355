"""Samples second views at given angles from a reference view, well separated from each other."""

import numpy as np

from ....core.errors import InputError
from ..camera import CameraRange, camera_center, look_at

_TRIES = 60
_MIN_SEPARATION = np.deg2rad(12.0)
"""Angle between new cameras, where possible, radians."""


def spread_views(
    rng: np.random.Generator,
    T_cam_world: np.ndarray,
    center: np.ndarray,
    count: int,
    angles: tuple[float, float],
    cameras: CameraRange,
) -> list[np.ndarray]:
    """Samples ``count`` cameras around a point that a first camera looks at.

    Their angles from the first camera are stratified over ``angles``, in random order. Their
    directions around its axis are uniform within the range of elevation.

    Args:
        rng: source of randomness.
        T_cam_world: the first camera, (4, 4).
        center: the point, (3,) meters, world.
        count: number of cameras.
        angles: (min, max) of the angle at the point between a new camera and the first, radians.
        cameras: range of distance, elevation, roll and look-at noise; azimuth is free.

    Returns:
        T_cam_world (4, 4) of each.

    Raises:
        InputError: if no direction within ``angles`` has an allowed elevation.
    """
    first = _direction(camera_center(T_cam_world) - center)
    side = _direction(np.cross(first, (0.0, 0.0, 1.0) if abs(first[2]) < 0.99 else (1.0, 0.0, 0.0)))
    up = np.cross(side, first)
    chosen = [first]
    poses = []
    for part in rng.permutation(count):
        low = angles[0] + (angles[1] - angles[0]) * part / count
        high = angles[0] + (angles[1] - angles[0]) * (part + 1) / count
        angle = rng.uniform(low, high, _TRIES)[:, None]
        bearing = rng.uniform(-np.pi, np.pi, _TRIES)[:, None]
        across = np.cos(bearing) * side + np.sin(bearing) * up
        candidates = np.cos(angle) * first + np.sin(angle) * across
        elevation = np.arcsin(np.clip(candidates[:, 2], -1.0, 1.0))
        allowed = (cameras.elevation[0] <= elevation) & (elevation <= cameras.elevation[1])
        candidates = candidates[allowed]
        if not len(candidates):
            raise InputError(
                f"no camera between {np.rad2deg(low):.0f} and {np.rad2deg(high):.0f} degrees from "
                f"the first has an elevation within {np.rad2deg(cameras.elevation)} degrees"
            )
        separation = np.arccos(np.clip(candidates @ np.transpose(chosen), -1.0, 1.0)).min(axis=1)
        # The first candidate that is separated enough, else the best.
        direction = candidates[np.argmax(np.minimum(separation, _MIN_SEPARATION))]
        chosen.append(direction)
        distance = rng.uniform(*cameras.distance)
        position = center + distance * direction
        aim = cameras.sample_aim(rng, center, distance, look_at(position, center))
        poses.append(look_at(position, aim, rng.uniform(-cameras.roll, cameras.roll)))
    return poses


def viewing_angle(T_cam_world: np.ndarray, other: np.ndarray, point: np.ndarray) -> float:
    """Returns the angle at ``point`` (3,) between the rays to two cameras, radians."""
    rays = [_direction(camera_center(T) - point) for T in (T_cam_world, other)]
    return float(np.arccos(np.clip(rays[0] @ rays[1], -1.0, 1.0)))


def _direction(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
