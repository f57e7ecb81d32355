"""What stands where on the table: the records, and what all ways of arranging share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...core.geometry import LINEMOD_IMAGE_SIZE, LINEMOD_K, crop_matrix, project, transform
from .camera import CameraRange
from .placement import PlacedObject, StablePose, is_collision_free

LMO_VISIBILITY = ((0.0, 0.05, 0.25, 0.5, 0.75, 1.0), (0.08, 0.17, 0.63, 0.88, 0.97, 1.0))
"""Quantiles of the target's visibility in LM-O: probabilities and values."""


@dataclass(frozen=True, eq=False)
class Prop:
    """Something on the table; ``size`` is MuJoCo's geom size of a plain shape, else None."""

    placed: PlacedObject
    size: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Everything on the table: objects by name, plain shapes by number."""

    objects: dict[str, Prop]
    shapes: dict[int, Prop]

    def rotated(self, center: np.ndarray, angle: float) -> Arrangement:
        """All of it turned by ``angle`` radians about ``center`` (2,)."""

        def turn(prop: Prop) -> Prop:
            return replace(prop, placed=prop.placed.rotated(center, angle))

        return Arrangement(
            {name: turn(prop) for name, prop in self.objects.items()},
            {i: turn(prop) for i, prop in self.shapes.items()},
        )

    def with_prop(self, key: str | int, prop: Prop) -> Arrangement:
        """``prop`` is added, or moved if it was there; what it would touch is removed."""

        def stays(name: str | int, other: Prop) -> bool:
            return name != key and is_collision_free(other.placed, [prop.placed])

        objects = {name: p for name, p in self.objects.items() if stays(name, p)}
        shapes = {i: p for i, p in self.shapes.items() if stays(i, p)}
        if isinstance(key, str):
            objects[key] = prop
        else:
            shapes[key] = prop
        return Arrangement(objects, shapes)

    def placed(self) -> list[PlacedObject]:
        """All props."""
        return [prop.placed for prop in (*self.objects.values(), *self.shapes.values())]

    def middle(self) -> np.ndarray:
        """The point in the middle of all objects, (3,) meters, world."""
        placed = [prop.placed for prop in self.objects.values()]
        xy = np.mean([p.xy for p in placed], axis=0)
        return np.append(xy, np.mean([p.rest.height for p in placed]) / 2)

    def clearance(self, points: np.ndarray) -> float:
        """How far points (N, 3) stay away from all props, as upright cylinders; meters."""
        nearest = np.inf
        for placed in self.placed():
            beside = np.linalg.norm(points[:, :2] - placed.xy, axis=1) - placed.rest.radius
            above = points[:, 2] - placed.rest.height
            nearest = min(nearest, float(np.maximum(beside, above).min()))
        return nearest


def sample_shape_size(rng: np.random.Generator, kind: str, tall: bool = False) -> np.ndarray:
    """A plain shape's size as MuJoCo's geom size, (3,) meters.

    Tall boxes and cylinders, up to 0.4 m, hide what is beside them; spheres are never tall.
    """
    if kind == "box":
        if tall:
            return rng.uniform((0.03, 0.02, 0.07), (0.09, 0.05, 0.2))
        return rng.uniform((0.02, 0.02, 0.015), (0.08, 0.06, 0.1))
    radius = rng.uniform(0.02, 0.05)
    if kind == "sphere":
        return np.array([radius, 0.0, 0.0])
    return np.array([radius, rng.uniform(*((0.03, 0.2) if tall else (0.015, 0.1))), 0.0])


def sample_resting_pose(
    rng: np.random.Generator, poses: list[StablePose], upright_probability: float
) -> StablePose:
    """The first pose, upright, with this probability, else any of the others."""
    if len(poses) == 1 or rng.uniform() < upright_probability:
        return poses[0]
    return poses[1 + rng.integers(len(poses) - 1)]


def probe_camera(points: np.ndarray, size: int) -> np.ndarray | None:
    """The camera (3, 3) of a small square image that holds all that LineMOD's camera sees.

    Args:
        points: what is to be seen, (N, 3) meters, camera frame.
        size: side of the image in pixels.

    Returns:
        K, or None where all the points lie behind the camera.
    """
    uv = project(points[points[:, 2] > 0.05], LINEMOD_K)
    if len(uv) == 0:
        return None
    low, high = uv.min(axis=0), uv.max(axis=0)
    side = 1.06 * float((high - low).max()) + 2.0
    return crop_matrix((low + high) / 2, side, size) @ LINEMOD_K


def framing_camera(
    cameras: CameraRange,
    rng: np.random.Generator,
    center: np.ndarray,
    points: np.ndarray,
    tries: int,
) -> np.ndarray:
    """A camera (4, 4) whose image holds all points (N, 3) of the world, or most of them.

    Args:
        cameras: where it may stand around ``center``.
        rng: draws it.
        center: (3,) meters.
        points: what should be in the image.
        tries: cameras to draw at most; the best one is taken.
    """
    height, width = LINEMOD_IMAGE_SIZE
    best, best_outside = None, np.inf
    for _ in range(tries):
        T = cameras.sample(rng, center)
        uv = project(transform(T, points), LINEMOD_K)
        outside = float(np.mean((uv < 2) | (uv > (width - 3, height - 3))))
        if outside < best_outside:
            best, best_outside = T, outside
        if outside == 0:
            break
    assert best is not None
    return best
