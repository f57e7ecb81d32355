"""Puts things on the table: each rests in a stable pose, none touches another.

Things are kept apart by their footprints, the convex hulls of their shadows straight down. That is
stricter than need be (nothing reaches over anything), exact, and takes microseconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import trimesh

from ..assets.object_model import ObjectModel
from ..pose_estimator.geometry import make_transform, transform

GAP = 0.003
"""Least distance between two footprints in metres."""
STEADY = 0.003
"""How far inside its support a thing's weight must act to be left lying that way, metres."""


@dataclass(frozen=True, eq=False)
class Resting:
    """A thing in a pose in which it rests on the table, its footprint centred on the origin.

    Attributes:
        T_table_obj: (4, 4) metres.
        footprint: corners of its convex footprint, counter-clockwise, (M, 2) metres.
        radius: of the circle around the origin that holds the footprint, metres.
        height: metres.
    """

    T_table_obj: np.ndarray
    footprint: np.ndarray
    radius: float
    height: float


@dataclass(frozen=True, eq=False)
class Placed:
    """A resting thing at a place on the table.

    Attributes:
        resting: the thing and the way it rests.
        xy: where its footprint's centre is, (2,) metres.
        yaw: its turn about the vertical, radians.
    """

    resting: Resting
    xy: np.ndarray
    yaw: float

    @property
    def outline(self) -> np.ndarray:
        """Footprint on the table, (M, 2) metres."""
        return self.resting.footprint @ _turn(self.yaw).T + self.xy

    @property
    def T_world_obj(self) -> np.ndarray:
        """The thing's pose in the world, (4, 4)."""
        turn = np.eye(3)
        turn[:2, :2] = _turn(self.yaw)
        return make_transform(turn, np.append(self.xy, 0.0)) @ self.resting.T_table_obj

    def rotated(self, centre: np.ndarray, angle: float) -> Placed:
        """The same thing after the table turned by ``angle`` radians about ``centre`` (2,)."""
        xy = centre + _turn(angle) @ (self.xy - centre)
        return Placed(self.resting, xy, self.yaw + angle)

    def moved(self, xy: np.ndarray) -> Placed:
        """The same thing elsewhere."""
        return Placed(self.resting, np.asarray(xy, dtype=np.float64), self.yaw)


def resting_poses(model: ObjectModel) -> list[Resting]:
    """The ways an object rests, upright first; precarious ones are left out."""
    mesh = trimesh.Trimesh(model.vertices, model.faces)
    centre = mesh.center_mass if mesh.is_volume else mesh.convex_hull.center_mass
    upright, *others = model.stable_poses
    steady = [T for T in others if _support_margin(model.vertices, centre, T) > STEADY]
    return [_rest(model.vertices, T) for T in (upright, *steady)]


def resting_shape(kind: str, size: np.ndarray) -> Resting:
    """A plain shape that stands on the table.

    Args:
        kind: "box", "cylinder" or "sphere".
        size: MuJoCo's geom size, (3,): half sides; radius and half height; radius.
    """
    if kind == "box":
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size[:2]
        half_height = size[2]
    else:
        angles = np.arange(24) * (2 * np.pi / 24)
        around = size[0] / np.cos(np.pi / 24)
        corners = around * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        half_height = size[1] if kind == "cylinder" else size[0]
    T = make_transform(np.eye(3), np.array([0.0, 0.0, half_height]))
    return Resting(T, corners, float(np.linalg.norm(corners, axis=1).max()), 2 * float(half_height))


def separated(a: np.ndarray, b: np.ndarray, gap: float = GAP) -> bool:
    """Whether two convex polygons (M, 2), (N, 2) are at least ``gap`` apart along some edge normal.

    This is the separating axis test; near two corners it may ask for a little more than ``gap``.
    """
    for first, second in ((a, b), (b, a)):
        edges = np.roll(first, -1, axis=0) - first
        normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        support = np.einsum("ij,ij->i", normals, first)
        if np.any((second @ normals.T).min(axis=0) - support >= gap):
            return True
    return False


def free(thing: Placed, others: list[Placed]) -> bool:
    """Whether ``thing`` keeps its distance from all the others."""
    outline = None
    for other in others:
        reach = thing.resting.radius + other.resting.radius + GAP
        if np.sum((thing.xy - other.xy) ** 2) >= reach * reach:
            continue
        outline = thing.outline if outline is None else outline
        if not separated(outline, other.outline):
            return False
    return True


def on_table(thing: Placed, half: tuple[float, ...]) -> bool:
    """Whether the whole footprint is on a table of these half sides, metres."""
    return bool(np.all(np.abs(thing.outline) <= np.asarray(half[:2]) - 0.01))


def pack(
    rng: np.random.Generator,
    resting: Resting,
    others: list[Placed],
    centre: np.ndarray,
    nearest: float,
    half: tuple[float, ...],
    reach: float = 0.6,
) -> Placed | None:
    """Puts a thing in a random direction from ``centre``, as near as ``nearest`` if it fits.

    It slides outwards until it touches nothing.

    Args:
        rng: draws direction and yaw.
        resting: the thing.
        others: what already stands there.
        centre: (2,) metres.
        nearest: least distance from the centre, metres.
        half: half sides of the table, metres.
        reach: farthest distance from the centre, metres.

    Returns:
        The placed thing, or None if there was no room in that direction.
    """
    angle, yaw = rng.uniform(-np.pi, np.pi, 2)
    direction = np.array([np.cos(angle), np.sin(angle)])
    for distance in np.arange(nearest, reach, 0.01):
        thing = Placed(resting, centre + distance * direction, yaw)
        if free(thing, others):
            return thing if on_table(thing, half) else None
    return None


def _support_margin(vertices: np.ndarray, centre_of_mass: np.ndarray, T: np.ndarray) -> float:
    """How far inside the polygon it stands on a thing's weight acts, metres."""
    points = transform(T, vertices)
    feet = points[points[:, 2] < points[:, 2].min() + 0.0005, :2].astype(np.float32)
    weight = transform(T, centre_of_mass)[:2]
    return cv2.pointPolygonTest(cv2.convexHull(feet), weight.tolist(), True)


def _rest(vertices: np.ndarray, T: np.ndarray) -> Resting:
    points = transform(T, vertices)
    outline = cv2.convexHull(points[:, :2].astype(np.float32))[:, 0].astype(np.float64)
    centre = (outline.min(axis=0) + outline.max(axis=0)) / 2
    low, high = points[:, 2].min(), points[:, 2].max()
    T = T.copy()
    T[:3, 3] -= (*centre, low)
    outline -= centre
    if np.sum(np.cross(*_pairs(outline))) < 0:
        outline = outline[::-1]
    radius = float(np.linalg.norm(outline, axis=1).max())
    return Resting(T, np.ascontiguousarray(outline), radius, float(high - low))


def _pairs(polygon: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each corner and the next, with a zero third coordinate."""
    solid = np.pad(polygon, ((0, 0), (0, 1)))
    return solid, np.roll(solid, -1, axis=0)


def _turn(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])
