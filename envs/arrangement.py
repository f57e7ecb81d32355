"""What stands where on the table: the records, and what all ways of arranging share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..pose_estimator.geometry import (
    LINEMOD_IMAGE_SIZE,
    LINEMOD_K,
    crop_matrix,
    project,
    transform,
)
from .camera import CameraRange
from .placement import Placed, Resting, free

if TYPE_CHECKING:
    from .scene import Scene

LMO_VISIBILITY = ((0.0, 0.05, 0.25, 0.5, 0.75, 1.0), (0.08, 0.17, 0.63, 0.88, 0.97, 1.0))
"""Quantiles of the target's visibility in LM-O: probabilities and values."""

PROBE_SIZE = 96


@dataclass(frozen=True, eq=False)
class Thing:
    """Something on the table; ``size`` is MuJoCo's geom size of a plain shape, else None."""

    placed: Placed
    size: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Everything on the table: objects by name, plain shapes by number."""

    objects: dict[str, Thing]
    shapes: dict[int, Thing]

    def rotated(self, centre: np.ndarray, angle: float) -> Arrangement:
        """All of it turned by ``angle`` about ``centre`` (2,)."""

        def turn(thing: Thing) -> Thing:
            return replace(thing, placed=thing.placed.rotated(centre, angle))

        return Arrangement(
            {name: turn(thing) for name, thing in self.objects.items()},
            {i: turn(thing) for i, thing in self.shapes.items()},
        )

    def placed(self) -> list[Placed]:
        """All things."""
        return [t.placed for t in (*self.objects.values(), *self.shapes.values())]

    def clearance(self, points: np.ndarray) -> float:
        """How far points (N, 3) stay away from all things, as upright cylinders; metres."""
        nearest = np.inf
        for thing in self.placed():
            beside = np.linalg.norm(points[:, :2] - thing.xy, axis=1) - thing.resting.radius
            above = points[:, 2] - thing.resting.height
            nearest = min(nearest, float(np.maximum(beside, above).min()))
        return nearest


def joined(base: Arrangement, name: str | int, thing: Thing) -> Arrangement:
    """``thing`` joins an arrangement; what it would touch leaves."""
    rest = {
        key: other
        for key, other in (*base.objects.items(), *base.shapes.items())
        if key != name and free(other.placed, [thing.placed])
    }
    rest[name] = thing
    return Arrangement(
        {key: t for key, t in rest.items() if isinstance(key, str)},
        {key: t for key, t in rest.items() if isinstance(key, int)},
    )


def draw_size(rng: np.random.Generator, kind: str) -> np.ndarray:
    """A plain shape's size as MuJoCo's geom size, (3,) metres."""
    if kind == "box":
        return rng.uniform((0.02, 0.02, 0.015), (0.08, 0.06, 0.1))
    if kind == "cylinder":
        return np.array([rng.uniform(0.02, 0.05), rng.uniform(0.015, 0.1), 0.0])
    return np.array([rng.uniform(0.02, 0.05), 0.0, 0.0])


def draw_tall_size(rng: np.random.Generator, kind: str) -> np.ndarray:
    """The size of a plain shape that hides what is beside it: up to 0.4 m tall (spheres are not).

    Returns:
        MuJoCo's geom size, (3,) metres.
    """
    if kind == "box":
        return rng.uniform((0.03, 0.02, 0.07), (0.09, 0.05, 0.2))
    if kind == "cylinder":
        return np.array([rng.uniform(0.02, 0.05), rng.uniform(0.03, 0.2), 0.0])
    return draw_size(rng, kind)


def draw_rest(rng: np.random.Generator, ways: list[Resting], upright: float) -> Resting:
    """Upright with this probability, else any of the other ways that a thing rests."""
    if len(ways) == 1 or rng.uniform() < upright:
        return ways[0]
    return ways[1 + rng.integers(len(ways) - 1)]


def probe_camera(points: np.ndarray, size: int) -> np.ndarray | None:
    """The camera (3, 3) of a small square picture that holds all that LineMOD's camera sees.

    Args:
        points: what is to be seen, (N, 3) metres, camera frame.
        size: side of the picture in pixels.

    Returns:
        K, or None where all the points lie behind the camera.
    """
    uv = project(points[points[:, 2] > 0.05], LINEMOD_K)
    if len(uv) == 0:
        return None
    low, high = uv.min(axis=0), uv.max(axis=0)
    side = 1.06 * float((high - low).max()) + 2.0
    return crop_matrix((low + high) / 2, side, size) @ LINEMOD_K


def target_visibility(
    scene: Scene, target: str, T_world_obj: np.ndarray, T_cam_world: np.ndarray
) -> float:
    """Visible fraction of an object of the scene as it stands, measured by a small picture."""
    points = transform(T_cam_world @ T_world_obj, scene.objects[target].vertices)
    K = probe_camera(points, PROBE_SIZE)
    return 0.0 if K is None else scene.visibility(target, T_cam_world, K, PROBE_SIZE)


def framing_camera(
    cameras: CameraRange,
    rng: np.random.Generator,
    centre: np.ndarray,
    points: np.ndarray,
    tries: int,
) -> np.ndarray:
    """A camera (4, 4) whose picture holds all points (N, 3) of the world, or most of them.

    Args:
        cameras: where it may stand around ``centre``.
        rng: draws it.
        centre: (3,) metres.
        points: what should be in the picture.
        tries: cameras to draw at most; the best one is taken.
    """
    height, width = LINEMOD_IMAGE_SIZE
    best, best_outside = None, np.inf
    for _ in range(tries):
        T = cameras.sample(rng, centre)
        uv = project(transform(T, points), LINEMOD_K)
        outside = float(np.mean((uv < 2) | (uv > (width - 3, height - 3))))
        if outside < best_outside:
            best, best_outside = T, outside
        if outside == 0:
            break
    assert best is not None
    return best
