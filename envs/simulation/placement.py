"""Places objects and plain shapes on the table in stable poses without collisions.

Collisions are tested between footprints, the convex hulls of the vertical projections. That is
conservative (nothing overhangs anything), exact, and takes microseconds.
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
"""Minimum distance between two footprints, meters."""
MIN_SUPPORT_MARGIN = 0.003
"""Minimum distance of the center of mass from the edge of the support polygon, meters."""


@dataclass(frozen=True, eq=False)
class StablePose:
    """A stable pose on the table, its footprint centered on the origin.

    Attributes:
        T_table_obj: (4, 4) meters.
        footprint: corners of the convex footprint, counter-clockwise, (M, 2) meters.
        radius: of the circle around the origin that contains the footprint, meters.
        height: meters.
    """

    T_table_obj: np.ndarray
    footprint: np.ndarray
    radius: float
    height: float


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """An object or plain shape on the table.

    Attributes:
        rest: its stable pose.
        xy: center of its footprint, (2,) meters.
        yaw: rotation about the vertical, radians.
    """

    rest: StablePose
    xy: np.ndarray
    yaw: float

    @property
    def outline(self) -> np.ndarray:
        """Footprint on the table, (M, 2) meters."""
        return self.rest.footprint @ _rotation(self.yaw).T + self.xy

    @property
    def T_world_obj(self) -> np.ndarray:
        """Its pose in the world, (4, 4)."""
        rotation = np.eye(3)
        rotation[:2, :2] = _rotation(self.yaw)
        return make_transform(rotation, np.append(self.xy, 0.0)) @ self.rest.T_table_obj

    def rotated(self, center: np.ndarray, angle: float) -> PlacedObject:
        """Returns this rotated by ``angle`` radians about ``center`` (2,)."""
        xy = center + _rotation(angle) @ (self.xy - center)
        return PlacedObject(self.rest, xy, self.yaw + angle)


def stable_poses(model: ObjectModel) -> list[StablePose]:
    """Returns the stable poses of an object, upright first, without precarious ones."""
    mesh = trimesh.Trimesh(model.vertices, model.faces)
    upright, *others = model.stable_poses
    stable = [T for T in others if support_margin(mesh, 0.0005, T) > MIN_SUPPORT_MARGIN]
    return [_stable_pose(model.vertices, T) for T in (upright, *stable)]


def resting_shape(kind: str, size: np.ndarray) -> StablePose:
    """Returns the stable pose of a plain shape.

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
    """Separating axis test: are convex polygons (M, 2), (N, 2) ``gap`` apart along an edge normal?

    Between two corners it may require slightly more than ``gap``.
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
    """Returns whether the footprint of ``placed`` is separated from all others."""
    for other in others:
        reach = placed.rest.radius + other.rest.radius + GAP
        near = np.sum((placed.xy - other.xy) ** 2) < reach * reach
        if near and not separated(placed.outline, other.outline):
            return False
    return True


def on_table(placed: PlacedObject) -> bool:
    """Returns whether the footprint is on the table, at least 1 cm from its edge."""
    return bool(np.all(np.abs(placed.outline) <= np.asarray(TABLE_HALF[:2]) - 0.01))


def pack(
    rng: np.random.Generator,
    rest: StablePose,
    others: list[PlacedObject],
    center: np.ndarray,
    min_distance: float = 0.0,
) -> PlacedObject | None:
    """Places an object in a random direction from ``center`` (2,), as close as it fits.

    It moves outwards from ``min_distance`` up to 0.6 m until it collides with none of the others.

    Returns:
        The placed object, or None if there is no room in that direction.
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


def _rotation(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])
