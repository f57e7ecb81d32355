"""Camera paths as a hand makes them: smooth, never quite steady, always looking at the scene.

A path is walked in little steps around the scene, at a distance that drifts. Heading, speed, aim
and roll change slowly; on top of that the hand trembles. With the default steps, frames that are
1, 5 and 10 apart have baselines of about 1.5 to 3, 7 to 14 and 15 to 27 cm, as in the LineMOD
sequences that the two-view paper takes its pairs from.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from ....core.errors import InputError
from ....core.geometry import make_transform
from ..camera import CameraRange, look_at, sphere_direction

LOWEST = 0.05
"""Least height of the camera above the table, meters."""

_CANDIDATES = 48
_WAVES = 4
_EDGE = np.deg2rad(1.0)
_LEVEL, _FREE = np.deg2rad(30.0), np.deg2rad(70.0)
"""Up to the first elevation the horizon is held level, above the second it is ignored."""

_STEP = (0.015, 0.028)
"""Shortest and longest distance between the camera centers of consecutive frames, meters."""
_MIN_TURN_RADIUS = 0.4
"""Of the path to the left or right, meters."""
_MAX_SLOPE = 0.35
"""Largest change of the distance to the scene for each meter of path."""
_PERIOD = (20.0, 80.0)
"""Shortest and longest period of what changes slowly, frames."""
_TREMOR = 0.0004
"""Largest displacement of a frame by tremor, meters."""
_SHAKE = np.deg2rad(0.15)
"""Standard deviation of the rotation by tremor about each axis of the camera, radians."""


def hand_held_path(
    rng: np.random.Generator,
    start: np.ndarray,
    center: np.ndarray,
    count: int,
    cameras: CameraRange,
) -> np.ndarray:
    """Draws the cameras of one sequence.

    Args:
        rng: where everything comes from.
        start: where the frame in the middle of the sequence stands, (3,) meters, world; moved into
            the range of ``cameras`` where it is not.
        center: the point that the camera looks at, (3,) meters, world.
        count: how many frames.
        cameras: distances and elevations that no frame leaves (but for the tremor); azimuth is
            free. Its look-at noise bounds how far the aim drifts, and its roll how far the roll
            does while the horizon is held level.

    Returns:
        T_cam_world of each frame, (count, 4, 4).

    Raises:
        InputError: if there is no frame.
    """
    if count < 1:
        raise InputError(f"a path needs at least one frame, got {count}")
    frames = np.arange(count)
    low, high = _STEP[0] + 2.05 * _TREMOR, _STEP[1] - 2.05 * _TREMOR
    steps = (low + high) / 2 + (high - low) / 2 * slow_drift(rng, frames[:-1])
    first = _into_range(start - center, center[2], cameras)
    rays = _walk(rng, first, center[2], steps, cameras)
    tremor = _trembling(rng, count)
    tremor *= _TREMOR / np.maximum(3.0, np.linalg.norm(tremor, axis=1, keepdims=True))
    return _aim(rng, center + rays + tremor, center, cameras)


def slow_drift(
    rng: np.random.Generator, frames: np.ndarray, shape: tuple[int, ...] = ()
) -> np.ndarray:
    """Band-limited random motion within -1 to 1: a few waves of random period and phase.

    Args:
        rng: where they come from.
        frames: when it is wanted, (F,), in frames.
        shape: how many independent drifts.

    Returns:
        (..., F): drifts of ``shape`` at each time.
    """
    frequency = rng.uniform(1 / _PERIOD[1], 1 / _PERIOD[0], (*shape, _WAVES, 1))
    phase = rng.uniform(-np.pi, np.pi, (*shape, _WAVES, 1))
    waves = np.sin(2 * np.pi * frequency * frames + phase).sum(axis=-2)
    return np.tanh(waves * np.sqrt(2 / _WAVES))


def _walk(
    rng: np.random.Generator,
    start: np.ndarray,
    height: float,
    steps: np.ndarray,
    cameras: CameraRange,
) -> np.ndarray:
    """Rays (F, 3) from the scene to the frames' places, walked from the middle to both ends.

    Many walks are tried at once and the first that stays in range is taken. The last two always
    do, or nearly: along the great circle that touches the starting point's parallel, and along
    that parallel itself.
    """
    frames = np.arange(len(steps))
    distance = float(np.linalg.norm(start))
    up = start / distance
    east = np.cross((0.0, 0.0, 1.0), up)
    east /= np.linalg.norm(east)
    angle = rng.uniform(-np.pi, np.pi, (_CANDIDATES, 1))
    turn = slow_drift(rng, frames, (_CANDIDATES,)) / _MIN_TURN_RADIUS
    slope = slow_drift(rng, frames, (_CANDIDATES,)) * _MAX_SLOPE
    angle[-2:] = slope[-2:] = turn[-2:] = 0.0
    turn[-1] = up[2] / np.hypot(up[0], up[1]) / distance
    heading = np.cos(angle) * east + np.sin(angle) * np.cross(up, east)

    rays = np.empty((_CANDIDATES, len(steps) + 1, 3))
    middle = (len(steps) + 1) // 2
    rays[:, middle] = start
    ways = ((1.0, range(middle, len(steps))), (-1.0, range(middle - 1, -1, -1)))
    for sign, order in ways:
        u, h, r = np.tile(up, (_CANDIDATES, 1)), sign * heading, np.full(_CANDIDATES, distance)
        for k in order:
            climb = sign * slope[:, k] * steps[k]
            # The chord between the two places is then as long as the step, but for its bend.
            along = np.sqrt((steps[k] ** 2 - climb**2) / (r * (r + climb)))
            h = _turned(h, u, sign * turn[:, k] * steps[k] / 2)
            cos, sin = np.cos(along)[:, None], np.sin(along)[:, None]
            u, h = cos * u + sin * h, cos * h - sin * u
            h = _turned(h, u, sign * turn[:, k] * steps[k] / 2)
            r = r + climb
            rays[:, k + 1 if sign > 0 else k] = r[:, None] * u

    reach = np.linalg.norm(rays, axis=2)
    sine = rays[..., 2] / reach
    inside = (reach >= cameras.distance[0]) & (reach <= cameras.distance[1])
    inside &= (sine >= np.sin(cameras.elevation[0])) & (sine <= np.sin(cameras.elevation[1]))
    inside &= height + rays[..., 2] >= LOWEST
    fits = inside.all(axis=1)
    fits[-1] = True
    return rays[np.argmax(fits)]


def _aim(
    rng: np.random.Generator,
    places: np.ndarray,
    center: np.ndarray,
    cameras: CameraRange,
) -> np.ndarray:
    """Points a camera at each place (F, 3) to the scene; T_cam_world (F, 4, 4)."""
    distance = np.linalg.norm(places - center, axis=1)
    held = rng.uniform(-0.7, 0.7, (3, 1))
    drift = slow_drift(rng, np.arange(len(places)), (3,))
    across, along, roll = held + 0.3 * drift
    offset = cameras.look_at_noise * distance * (1.3 * across, along)
    aims = [center + o @ look_at(p, center)[:2, :3] for o, p in zip(offset.T, places, strict=True)]
    level = np.array([look_at(p, aim) for p, aim in zip(places, aims, strict=True)])[:, :3, :3]
    # Seen from above, a level image would spin as the camera goes by. A hand does not.
    spin = Rotation.from_matrix(level[1:] @ np.swapaxes(level[:-1], 1, 2)).as_rotvec()[:, 2]
    elevation = np.arcsin(-level[1:, 2, 2])
    spin *= np.clip((elevation - _LEVEL) / (_FREE - _LEVEL), 0.0, 1.0)
    spin = np.append(0.0, np.cumsum(spin))
    roll = cameras.roll * roll + spin - spin[len(spin) // 2]
    shake = Rotation.from_rotvec(_SHAKE * _trembling(rng, len(places))).as_matrix()
    return np.array(
        [
            make_transform(S, np.zeros(3)) @ look_at(*camera)
            for S, *camera in zip(shake, places, aims, roll, strict=True)
        ]
    )


def _into_range(ray: np.ndarray, height: float, cameras: CameraRange) -> np.ndarray:
    """The nearest ray (3,) from a scene at ``height`` that ends well where a camera may stand."""
    distance = np.clip(np.linalg.norm(ray), *cameras.distance)
    lowest = np.arcsin(np.clip((LOWEST - height) / distance, -1.0, 1.0))
    low, high = max(cameras.elevation[0], lowest) + _EDGE, cameras.elevation[1] - _EDGE
    elevation = np.clip(np.arcsin(ray[2] / np.linalg.norm(ray)), low, max(low, high))
    return distance * sphere_direction(np.arctan2(ray[1], ray[0]), elevation)


def _trembling(rng: np.random.Generator, count: int) -> np.ndarray:
    """Noise (count, 3) of unit variance whose neighbors are alike."""
    noise = rng.standard_normal((count + 2, 3))
    return (noise[:-2] + 2.0 * noise[1:-1] + noise[2:]) / np.sqrt(6.0)


def _turned(heading: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Headings (N, 3) turned by angles (N,) about the unit axes (N, 3) they are square to."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return cos * heading + sin * np.cross(axis, heading)
