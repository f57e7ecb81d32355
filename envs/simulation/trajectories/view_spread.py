"""Second views: cameras at chosen angles from a first one, well apart from each other."""

from __future__ import annotations

import numpy as np

from ....core.errors import InputError
from ..camera import CameraRange, camera_center, look_at

_TRIES = 60
_APART = np.deg2rad(12.0)
"""The angle that new cameras keep between each other where that is possible."""


def spread_views(
    rng: np.random.Generator,
    T_cam_world: np.ndarray,
    center: np.ndarray,
    count: int,
    angles: tuple[float, float],
    cameras: CameraRange,
) -> list[np.ndarray]:
    """Draws ``count`` cameras around a point that a first camera looks at.

    Their angles from the first camera are spread evenly over ``angles``: each takes one of
    ``count`` equal parts of that interval, in random order. Around the first camera they lie
    anywhere, as long as elevation allows.

    Args:
        rng: where they come from.
        T_cam_world: the first camera, (4, 4).
        center: the point, (3,) meters, world.
        count: how many.
        angles: smallest and largest angle at the point between a new camera and the first, radians.
        cameras: distances, elevations, roll and look-at noise of the new ones; azimuth is free.

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
        nearest = np.arccos(np.clip(candidates @ np.transpose(chosen), -1.0, 1.0)).min(axis=1)
        direction = candidates[np.argmax(np.minimum(nearest, _APART))]  # the first that is enough
        chosen.append(direction)
        distance = rng.uniform(*cameras.distance)
        position = center + distance * direction
        aim = cameras.sample_aim(rng, center, distance, look_at(position, center))
        poses.append(look_at(position, aim, rng.uniform(-cameras.roll, cameras.roll)))
    return poses


def viewing_angle(T_cam_world: np.ndarray, other: np.ndarray, point: np.ndarray) -> float:
    """The angle at ``point`` (3,) between the rays to two cameras, radians."""
    rays = [_direction(camera_center(T) - point) for T in (T_cam_world, other)]
    return float(np.arccos(np.clip(rays[0] @ rays[1], -1.0, 1.0)))


def _direction(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
