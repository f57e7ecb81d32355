"""Hand-held camera paths: smooth, with tremor, looking at the scene.

A path is integrated in small steps around the scene. Distance, heading, speed, aim and roll drift
slowly; tremor is added. Frames at gaps of 1, 5 and 10 have baselines of about 1.5 to 3, 7 to 14 and
15 to 27 cm, as in the LineMOD sequences of the two-view paper.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from ....core.errors import InputError
from ....core.geometry import make_transform
from ..camera import CameraRange, look_at, sphere_direction

MIN_HEIGHT = 0.05
"""Of the camera above the table, meters."""

_CANDIDATES = 48
_WAVES = 4
_EDGE = np.deg2rad(1.0)
_LEVEL, _FREE = np.deg2rad(30.0), np.deg2rad(70.0)
"""The horizon is level below the first elevation and ignored above the second."""

_STEP = (0.015, 0.028)
"""Range of the distance between the camera centers of consecutive frames, meters."""
_MIN_TURN_RADIUS = 0.4
"""Minimum radius of curvature of the path to the left or right, meters."""
_MAX_SLOPE = 0.35
"""Maximum change of the distance to the scene per meter of path."""
_PERIOD = (20.0, 80.0)
"""Range of the period of slow drifts, frames."""
_TREMOR = 0.0004
"""Maximum displacement of a frame by tremor, meters."""
_SHAKE = np.deg2rad(0.15)
"""Standard deviation of the rotation by tremor about each axis of the camera, radians."""


def hand_held_path(
    rng: np.random.Generator,
    start: np.ndarray,
    center: np.ndarray,
    count: int,
    cameras: CameraRange,
) -> np.ndarray:
    """Samples the cameras of one sequence.

    Args:
        rng: source of randomness.
        start: position of the middle frame, (3,) meters, world; clipped to ``cameras``.
        center: point that the camera looks at, (3,) meters, world.
        count: number of frames.
        cameras: range of distance and elevation (before tremor); azimuth is free. Look-at noise and
            roll bound the drift of aim and, while the horizon is level, of roll.

    Returns:
        T_cam_world of each frame, (count, 4, 4).

    Raises:
        InputError: if ``count`` is 0.
    """
    if count < 1:
        raise InputError(f"a path needs at least one frame, got {count}")
    frames = np.arange(count)
    low, high = _STEP[0] + 2.05 * _TREMOR, _STEP[1] - 2.05 * _TREMOR
    steps = (low + high) / 2 + (high - low) / 2 * slow_drift(rng, frames[:-1])
    first = _clip_to_range(start - center, center[2], cameras)
    rays = _integrate_path(rng, first, center[2], steps, cameras)
    tremor = _smooth_noise(rng, count)
    tremor *= _TREMOR / np.maximum(3.0, np.linalg.norm(tremor, axis=1, keepdims=True))
    return _aim(rng, center + rays + tremor, center, cameras)


def slow_drift(
    rng: np.random.Generator, frames: np.ndarray, shape: tuple[int, ...] = ()
) -> np.ndarray:
    """Samples band-limited noise in [-1, 1]: sums of sines of random period and phase.

    Args:
        rng: source of randomness.
        frames: times, (F,), in frames.
        shape: of independent drifts.

    Returns:
        (*shape, F).
    """
    frequency = rng.uniform(1 / _PERIOD[1], 1 / _PERIOD[0], (*shape, _WAVES, 1))
    phase = rng.uniform(-np.pi, np.pi, (*shape, _WAVES, 1))
    waves = np.sin(2 * np.pi * frequency * frames + phase).sum(axis=-2)
    return np.tanh(waves * np.sqrt(2 / _WAVES))


def _integrate_path(
    rng: np.random.Generator,
    start: np.ndarray,
    height: float,
    steps: np.ndarray,
    cameras: CameraRange,
) -> np.ndarray:
    """Integrates rays (F, 3) from the scene to the camera centers, from the middle to both ends.

    The first of many candidate paths that stays in range is returned. The last two always do, or
    nearly: the great circle tangent to the starting point's parallel, and that parallel itself.
    """
    frames = np.arange(len(steps))
    distance = float(np.linalg.norm(start))
    up = start / distance
    east = np.cross((0.0, 0.0, 1.0), up)
    east /= np.linalg.norm(east)
    angle = rng.uniform(-np.pi, np.pi, (_CANDIDATES, 1))
    curvature = slow_drift(rng, frames, (_CANDIDATES,)) / _MIN_TURN_RADIUS
    slope = slow_drift(rng, frames, (_CANDIDATES,)) * _MAX_SLOPE
    angle[-2:] = slope[-2:] = curvature[-2:] = 0.0
    curvature[-1] = up[2] / np.hypot(up[0], up[1]) / distance
    heading = np.cos(angle) * east + np.sin(angle) * np.cross(up, east)

    rays = np.empty((_CANDIDATES, len(steps) + 1, 3))
    middle = (len(steps) + 1) // 2
    rays[:, middle] = start
    directions = ((1.0, range(middle, len(steps))), (-1.0, range(middle - 1, -1, -1)))
    for sign, order in directions:
        u, h, r = np.tile(up, (_CANDIDATES, 1)), sign * heading, np.full(_CANDIDATES, distance)
        for k in order:
            climb = sign * slope[:, k] * steps[k]
            # Chosen so that the chord is as long as the step, up to curvature.
            along = np.sqrt((steps[k] ** 2 - climb**2) / (r * (r + climb)))
            h = _rotated(h, u, sign * curvature[:, k] * steps[k] / 2)
            cos, sin = np.cos(along)[:, None], np.sin(along)[:, None]
            u, h = cos * u + sin * h, cos * h - sin * u
            h = _rotated(h, u, sign * curvature[:, k] * steps[k] / 2)
            r = r + climb
            rays[:, k + 1 if sign > 0 else k] = r[:, None] * u

    reach = np.linalg.norm(rays, axis=2)
    sine = rays[..., 2] / reach
    inside = (reach >= cameras.distance[0]) & (reach <= cameras.distance[1])
    inside &= (sine >= np.sin(cameras.elevation[0])) & (sine <= np.sin(cameras.elevation[1]))
    inside &= height + rays[..., 2] >= MIN_HEIGHT
    fits = inside.all(axis=1)
    fits[-1] = True
    return rays[np.argmax(fits)]


def _aim(
    rng: np.random.Generator, positions: np.ndarray, center: np.ndarray, cameras: CameraRange
) -> np.ndarray:
    """Returns T_cam_world (F, 4, 4) of cameras at (F, 3) that look at the scene."""
    distance = np.linalg.norm(positions - center, axis=1)
    offset = rng.uniform(-0.7, 0.7, (3, 1))
    drift = slow_drift(rng, np.arange(len(positions)), (3,))
    across, along, roll = offset + 0.3 * drift
    offset = cameras.look_at_noise * distance * (1.3 * across, along)
    pairs = zip(offset.T, positions, strict=True)
    aims = [center + o @ look_at(p, center)[:2, :3] for o, p in pairs]
    level = np.array([look_at(p, aim) for p, aim in zip(positions, aims, strict=True)])[:, :3, :3]
    # Seen from above, level images would spin as the camera passes. A hand does not.
    spin = Rotation.from_matrix(level[1:] @ np.swapaxes(level[:-1], 1, 2)).as_rotvec()[:, 2]
    elevation = np.arcsin(-level[1:, 2, 2])
    spin *= np.clip((elevation - _LEVEL) / (_FREE - _LEVEL), 0.0, 1.0)
    spin = np.append(0.0, np.cumsum(spin))
    roll = cameras.roll * roll + spin - spin[len(spin) // 2]
    shake = Rotation.from_rotvec(_SHAKE * _smooth_noise(rng, len(positions))).as_matrix()
    frames = zip(shake, positions, aims, roll, strict=True)
    return np.array([make_transform(S, np.zeros(3)) @ look_at(*camera) for S, *camera in frames])


def _clip_to_range(ray: np.ndarray, height: float, cameras: CameraRange) -> np.ndarray:
    """Clips a ray (3,) from a scene at ``height`` to the allowed camera positions."""
    distance = np.clip(np.linalg.norm(ray), *cameras.distance)
    lowest = np.arcsin(np.clip((MIN_HEIGHT - height) / distance, -1.0, 1.0))
    low, high = max(cameras.elevation[0], lowest) + _EDGE, cameras.elevation[1] - _EDGE
    elevation = np.clip(np.arcsin(ray[2] / np.linalg.norm(ray)), low, max(low, high))
    return distance * sphere_direction(np.arctan2(ray[1], ray[0]), elevation)


def _smooth_noise(rng: np.random.Generator, count: int) -> np.ndarray:
    """Samples unit-variance noise (count, 3), correlated between neighbors."""
    noise = rng.standard_normal((count + 2, 3))
    return (noise[:-2] + 2.0 * noise[1:-1] + noise[2:]) / np.sqrt(6.0)


def _rotated(heading: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotates headings (N, 3) by angles (N,) about orthogonal unit axes (N, 3)."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return cos * heading + sin * np.cross(axis, heading)
