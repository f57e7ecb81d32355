"""Placement of props on the table: records and sampling shared by all scene kinds."""

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
    """An object or plain shape on the table; ``size`` is a shape's MuJoCo geom size, else None."""

    placed: PlacedObject
    size: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Arrangement:
    """All props on the table: objects by name, plain shapes by number."""

    objects: dict[str, Prop]
    shapes: dict[int, Prop]

    def rotated(self, center: np.ndarray, angle: float) -> Arrangement:
        """Returns all props rotated by ``angle`` radians about ``center`` (2,)."""

        def rotate(prop: Prop) -> Prop:
            return replace(prop, placed=prop.placed.rotated(center, angle))

        return Arrangement(
            {name: rotate(prop) for name, prop in self.objects.items()},
            {i: rotate(prop) for i, prop in self.shapes.items()},
        )

    def with_prop(self, key: str | int, prop: Prop) -> Arrangement:
        """Returns this with ``prop`` added or moved, and props that collide with it removed."""

        def keep(name: str | int, other: Prop) -> bool:
            return name != key and is_collision_free(other.placed, [prop.placed])

        objects = {name: p for name, p in self.objects.items() if keep(name, p)}
        shapes = {i: p for i, p in self.shapes.items() if keep(i, p)}
        if isinstance(key, str):
            objects[key] = prop
        else:
            shapes[key] = prop
        return Arrangement(objects, shapes)

    def placed(self) -> list[PlacedObject]:
        """All props."""
        return [prop.placed for prop in (*self.objects.values(), *self.shapes.values())]

    def center(self) -> np.ndarray:
        """Returns the center of all objects, (3,) meters, world."""
        placed = [prop.placed for prop in self.objects.values()]
        xy = np.mean([p.xy for p in placed], axis=0)
        return np.append(xy, np.mean([p.rest.height for p in placed]) / 2)

    def clearance(self, points: np.ndarray) -> float:
        """Returns the smallest distance of points (N, 3) to props as cylinders, meters."""
        clearance = np.inf
        for placed in self.placed():
            lateral = np.linalg.norm(points[:, :2] - placed.xy, axis=1) - placed.rest.radius
            above = points[:, 2] - placed.rest.height
            clearance = min(clearance, float(np.maximum(lateral, above).min()))
        return clearance


def sample_shape_size(rng: np.random.Generator, kind: str, tall: bool = False) -> np.ndarray:
    """Samples the MuJoCo geom size of a plain shape, (3,) meters.

    Tall boxes and cylinders, up to 0.4 m, occlude their neighbors; spheres are never tall.
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
    """Samples the first pose (upright) with this probability, else any of the others."""
    if len(poses) == 1 or rng.uniform() < upright_probability:
        return poses[0]
    return poses[1 + rng.integers(len(poses) - 1)]


def probe_camera(points: np.ndarray, size: int) -> np.ndarray | None:
    """Returns K (3, 3) of a square crop of LineMOD's camera that contains the points.

    Args:
        points: (N, 3) meters, camera frame.
        size: side of the image in pixels.

    Returns:
        K, or None if all points lie behind the camera.
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
    """Samples a camera (4, 4) whose image contains all world points (N, 3), or most of them.

    At most ``tries`` cameras are sampled from the range around ``center`` (3,); the best is kept.
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
