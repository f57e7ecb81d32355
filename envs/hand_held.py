"""Camera paths as a hand makes them: smooth, never quite steady, always looking at the scene.

A path is walked in little steps around the scene, at a distance that drifts. Heading, speed, aim
and roll change slowly; on top of that the hand trembles. With the default steps, frames that are
1, 5 and 10 apart have baselines of about 1.5 to 3, 7 to 14 and 15 to 27 cm, as in the LineMOD
sequences that the two-view paper takes its pairs from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..pose_estimator.geometry import make_transform
from .camera import CameraRange, look_at

LOWEST = 0.05
"""Least height of the camera above the table, metres."""

_CANDIDATES = 48
_WAVES = 4
_EDGE = np.deg2rad(1.0)
_LEVEL, _FREE = np.deg2rad(30.0), np.deg2rad(70.0)
"""Up to the first elevation the horizon is held level, from the second on it is not heeded."""


@dataclass(frozen=True)
class HandConfig:
    """How a hand moves a camera.

    Attributes:
        step: shortest and longest distance between the centres of consecutive frames, metres.
        tightest_turn: radius of the tightest turn to the left or right, metres.
        slope: largest change of the distance to the scene for each metre of path.
        period: shortest and longest period of what changes slowly, frames.
        tremor: largest displacement of a frame by tremor, metres.
        shake: standard deviation of the turn by tremor about each axis of the camera, radians.
    """

    step: tuple[float, float] = (0.015, 0.028)
    tightest_turn: float = 0.4
    slope: float = 0.35
    period: tuple[float, float] = (20.0, 80.0)
    tremor: float = 0.0004
    shake: float = np.deg2rad(0.15)

    def __post_init__(self) -> None:
        if min(self.step[0], self.tightest_turn) <= 0 or min(self.tremor, self.shake) < 0:
            raise ValueError(f"lengths must be positive and tremor not negative, got {self}")
        if not 5 * self.tremor < self.step[1] - self.step[0]:
            raise ValueError(
                "step must be (shortest, longest), further apart than five times the tremor of "
                f"{self.tremor} m, got {self.step}"
            )
        if not 0 <= self.slope < 1:
            raise ValueError(f"slope must be at least 0 and below 1, got {self.slope}")
        if not 2 <= self.period[0] <= self.period[1]:
            raise ValueError(f"period must rise from at least 2 frames, got {self.period}")


def hand_held_path(
    rng: np.random.Generator,
    start: np.ndarray,
    centre: np.ndarray,
    count: int,
    cameras: CameraRange,
    hand: HandConfig = HandConfig(),
) -> np.ndarray:
    """Draws the cameras of one sequence.

    Args:
        rng: where everything comes from.
        start: where the frame in the middle of the sequence stands, (3,) metres, world; moved into
            the range of ``cameras`` where it is not.
        centre: the point that the camera looks at, (3,) metres, world.
        count: how many frames.
        cameras: distances and elevations that no frame leaves (but for the tremor); azimuth is
            free. Its look-at noise bounds how far the aim drifts, and its roll how far the roll
            does while the horizon is heeded.
        hand: how the hand moves.

    Returns:
        T_cam_world of each frame, (count, 4, 4).

    Raises:
        ValueError: if there is no frame.
    """
    if count < 1:
        raise ValueError(f"a path needs at least one frame, got {count}")
    frames = np.arange(count)
    low, high = hand.step[0] + 2.05 * hand.tremor, hand.step[1] - 2.05 * hand.tremor
    steps = (low + high) / 2 + (high - low) / 2 * slow_drift(rng, frames[:-1], hand.period)
    first = _into_range(start - centre, centre[2], cameras)
    rays = _walk(rng, first, centre[2], steps, cameras, hand)
    tremor = _trembling(rng, count)
    tremor *= hand.tremor / np.maximum(3.0, np.linalg.norm(tremor, axis=1, keepdims=True))
    return _aim(rng, centre + rays + tremor, centre, cameras, hand)


def slow_drift(
    rng: np.random.Generator,
    frames: np.ndarray,
    period: tuple[float, float],
    shape: tuple[int, ...] = (),
) -> np.ndarray:
    """Band-limited random motion within -1 to 1: a few waves of random period and phase.

    Args:
        rng: where they come from.
        frames: when it is wanted, (F,), in frames.
        period: shortest and longest period, frames.
        shape: how many independent drifts.

    Returns:
        (..., F): drifts of ``shape`` at each time.
    """
    frequency = rng.uniform(1 / period[1], 1 / period[0], (*shape, _WAVES, 1))
    phase = rng.uniform(-np.pi, np.pi, (*shape, _WAVES, 1))
    waves = np.sin(2 * np.pi * frequency * frames + phase).sum(axis=-2)
    return np.tanh(waves * np.sqrt(2 / _WAVES))


def _walk(
    rng: np.random.Generator,
    start: np.ndarray,
    height: float,
    steps: np.ndarray,
    cameras: CameraRange,
    hand: HandConfig,
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
    turn = slow_drift(rng, frames, hand.period, (_CANDIDATES,)) / hand.tightest_turn
    slope = slow_drift(rng, frames, hand.period, (_CANDIDATES,)) * hand.slope
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
    centre: np.ndarray,
    cameras: CameraRange,
    hand: HandConfig,
) -> np.ndarray:
    """Points a camera at each place (F, 3) to the scene; T_cam_world (F, 4, 4)."""
    distance = np.linalg.norm(places - centre, axis=1)
    held = rng.uniform(-0.7, 0.7, (3, 1))
    drift = slow_drift(rng, np.arange(len(places)), hand.period, (3,))
    across, along, roll = held + 0.3 * drift
    offset = cameras.look_at_noise * distance * (1.3 * across, along)
    aims = [centre + o @ look_at(p, centre)[:2, :3] for o, p in zip(offset.T, places, strict=True)]
    level = np.array([look_at(p, aim) for p, aim in zip(places, aims, strict=True)])[:, :3, :3]
    # Seen from above, a level picture would spin as the camera goes by. A hand does not.
    spin = Rotation.from_matrix(level[1:] @ np.swapaxes(level[:-1], 1, 2)).as_rotvec()[:, 2]
    elevation = np.arcsin(-level[1:, 2, 2])
    spin *= np.clip((elevation - _LEVEL) / (_FREE - _LEVEL), 0.0, 1.0)
    spin = np.append(0.0, np.cumsum(spin))
    roll = cameras.roll * roll + spin - spin[len(spin) // 2]
    shake = Rotation.from_rotvec(hand.shake * _trembling(rng, len(places))).as_matrix()
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
    azimuth = np.arctan2(ray[1], ray[0])
    level = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
    return distance * np.append(level, np.sin(elevation))


def _trembling(rng: np.random.Generator, count: int) -> np.ndarray:
    """Noise (count, 3) of unit variance whose neighbours are alike."""
    noise = rng.standard_normal((count + 2, 3))
    return (noise[:-2] + 2.0 * noise[1:-1] + noise[2:]) / np.sqrt(6.0)


def _turned(heading: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Headings (N, 3) turned by angles (N,) about the unit axes (N, 3) they are square to."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return cos * heading + sin * np.cross(axis, heading)
