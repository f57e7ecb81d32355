"""What the rest of the project knows about one object."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A textured mesh with all that pose estimation asks of it.

    Everything is in the object's own frame, in meters. The frame is LineMOD's: the origin is the
    center of the bounding box and +z is up when the object stands as it does in LineMOD.

    Attributes:
        name: what users and weights call it.
        obj_id: its number in BOP files (LineMOD's number for our thirteen).
        vertices: (V, 3) float64.
        faces: (F, 3) int32 indices into ``vertices``, counter-clockwise from outside.
        uv: (V, 2) float32 texture coordinates in [0, 1], v up (OpenGL). Vertices on texture seams
            are duplicated, so that there is one uv for each vertex.
        texture: (H, W, 3) uint8 RGB, row 0 at the top of the picture (v = 1).
        keypoints: (9, 3) float64: eight by farthest point sampling on the surface, then the center
            (the origin of the frame).
        diameter: largest distance between two surface points.
        symmetries: (S, 4, 4) float64 discrete symmetry transforms, identity first.
        points: (P, 3) float64 points spread evenly over the surface; ADD and ADD-S are taken on
            them. There are none (P = 0) where the mesh must not be passed on; ``vertices`` are then
            those of the bounding box.
        stable_poses: (N, 4, 4) float64 T_table_obj in which the object rests on the plane z = 0;
            the first is upright, the others in order of falling probability.
        specular: MuJoCo material specularity, 0 to 1.
        shininess: MuJoCo material shininess, 0 to 1.
    """

    name: str
    obj_id: int
    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    texture: np.ndarray
    keypoints: np.ndarray
    diameter: float
    symmetries: np.ndarray
    points: np.ndarray
    stable_poses: np.ndarray
    specular: float = field(default=0.2)
    shininess: float = field(default=0.3)

    @property
    def has_surface(self) -> bool:
        """Whether the mesh is the object's, and not its bounding box."""
        return len(self.points) > 0

    @property
    def symmetric(self) -> bool:
        """Whether ADD-S is the measure for this object."""
        return len(self.symmetries) > 1

    @property
    def extents(self) -> np.ndarray:
        """Side lengths of the axis-aligned bounding box, (3,)."""
        return np.ptp(self.vertices, axis=0)
