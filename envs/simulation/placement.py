"""Puts objects and plain shapes on the table: each in a stable pose, none touching another.

They are kept apart by their footprints, the convex hulls of their shadows straight down. That is
stricter than need be (nothing reaches over anything), exact, and takes microseconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import trimesh

from ...assets.object_model import ObjectModel
from ...assets.surface import support_margin
from ...core.geometry import make_transform, transform
from .world import TABLE_HALF

GAP = 0.003
"""Smallest distance between two footprints, meters."""
MIN_SUPPORT_MARGIN = 0.003
"""How far inside its support polygon the center of mass of a resting object is, meters."""


@dataclass(frozen=True, eq=False)
class StablePose:
    """A pose in which something rests on the table, its footprint centered on the origin.

    Attributes:
        T_table_obj: (4, 4) meters.
        footprint: corners of its convex footprint, counter-clockwise, (M, 2) meters.
        radius: of the circle around the origin that holds the footprint, meters.
        height: meters.
    """

    T_table_obj: np.ndarray
    footprint: np.ndarray
    radius: float
    height: float


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """An object or plain shape at a place on the table.

    Attributes:
        rest: how it rests.
        xy: where its footprint's center is, (2,) meters.
        yaw: its turn about the vertical, radians.
    """

    rest: StablePose
    xy: np.ndarray
    yaw: float

    @property
    def outline(self) -> np.ndarray:
        """Footprint on the table, (M, 2) meters."""
        return self.rest.footprint @ _turn(self.yaw).T + self.xy

    @property
    def T_world_obj(self) -> np.ndarray:
        """Its pose in the world, (4, 4)."""
        turn = np.eye(3)
        turn[:2, :2] = _turn(self.yaw)
        return make_transform(turn, np.append(self.xy, 0.0)) @ self.rest.T_table_obj

    def rotated(self, center: np.ndarray, angle: float) -> PlacedObject:
        """The same after the table turned by ``angle`` radians about ``center`` (2,)."""
        xy = center + _turn(angle) @ (self.xy - center)
        return PlacedObject(self.rest, xy, self.yaw + angle)


def stable_poses(model: ObjectModel) -> list[StablePose]:
    """The ways an object rests, upright first; precarious ones are left out."""
    mesh = trimesh.Trimesh(model.vertices, model.faces)
    upright, *others = model.stable_poses
    stable = [T for T in others if support_margin(mesh, 0.0005, T) > MIN_SUPPORT_MARGIN]
    return [_stable_pose(model.vertices, T) for T in (upright, *stable)]


def resting_shape(kind: str, size: np.ndarray) -> StablePose:
    """How a plain shape stands on the table.

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
    radius = float(np.linalg.norm(corners, axis=1).max())
    return StablePose(T, corners, radius, 2 * float(half_height))


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


def is_collision_free(placed: PlacedObject, others: list[PlacedObject]) -> bool:
    """Whether ``placed`` keeps its distance from all the others."""
    outline = None
    for other in others:
        reach = placed.rest.radius + other.rest.radius + GAP
        if np.sum((placed.xy - other.xy) ** 2) >= reach * reach:
            continue
        outline = placed.outline if outline is None else outline
        if not separated(outline, other.outline):
            return False
    return True


def on_table(placed: PlacedObject) -> bool:
    """Whether the whole footprint is on the table, at least 1 cm from its edge."""
    return bool(np.all(np.abs(placed.outline) <= np.asarray(TABLE_HALF[:2]) - 0.01))


def pack(
    rng: np.random.Generator,
    rest: StablePose,
    others: list[PlacedObject],
    center: np.ndarray,
    min_distance: float = 0.0,
) -> PlacedObject | None:
    """Puts something in a random direction from ``center``, as near as it fits.

    It slides outwards, up to 0.6 m, until it touches nothing.

    Args:
        rng: draws direction and yaw.
        rest: how it rests.
        others: what already stands there.
        center: (2,) meters.
        min_distance: where it starts, meters from the center.

    Returns:
        What was placed, or None if there was no room in that direction.
    """
    angle, yaw = rng.uniform(-np.pi, np.pi, 2)
    direction = np.array([np.cos(angle), np.sin(angle)])
    for distance in np.arange(min_distance, 0.6, 0.01):
        placed = PlacedObject(rest, center + distance * direction, yaw)
        if is_collision_free(placed, others):
            return placed if on_table(placed) else None
    return None


def _stable_pose(vertices: np.ndarray, T: np.ndarray) -> StablePose:
    points = transform(T, vertices)
    outline = cv2.convexHull(points[:, :2].astype(np.float32))[:, 0].astype(np.float64)
    center = (outline.min(axis=0) + outline.max(axis=0)) / 2
    low, high = points[:, 2].min(), points[:, 2].max()
    T = T.copy()
    T[:3, 3] -= (*center, low)
    outline -= center
    radius = float(np.linalg.norm(outline, axis=1).max())
    return StablePose(T, outline, radius, float(high - low))


def _turn(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])
