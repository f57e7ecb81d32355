"""The data of one object."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A textured mesh with the data for pose estimation.

    Everything is in the object's own frame, in meters. The frame is LineMOD's: the origin is the
    center of the bounding box and +z is up if the object stands as in LineMOD.

    Attributes:
        name: for users and weights.
        obj_id: in BOP files (LineMOD's for our thirteen).
        vertices: (V, 3) float64.
        faces: (F, 3) int32 indices into ``vertices``, counter-clockwise from outside.
        uv: (V, 2) float32 texture coordinates in [0, 1], v up (OpenGL). Vertices on texture seams
            are duplicated.
        texture: (H, W, 3) uint8 RGB, row 0 at the top of the image (v = 1).
        keypoints: (9, 3) float64: eight by farthest point sampling on the surface, then the center
            (the origin of the frame).
        diameter: largest distance between two surface points.
        symmetries: (S, 4, 4) float64 discrete symmetry transforms, identity first.
        points: (P, 3) float64 evenly spaced surface points, for ADD and ADD-S. Without a
            redistributable mesh P = 0, and ``vertices`` are those of the bounding box.
        stable_poses: (N, 4, 4) float64 T_table_obj in which the object rests on the plane z = 0;
            the first is upright, the others in order of decreasing probability.
        specular: MuJoCo material specularity, 0 to 1.
        shininess: MuJoCo material shininess, 0 to 1.
        origin: how a user's mesh was read: unit, size, colors; in words, for users.
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
    specular: float = 0.2
    shininess: float = 0.3
    origin: str = ""

    @property
    def has_surface(self) -> bool:
        """Whether the mesh is the object's, not its bounding box."""
        return len(self.points) > 0

    @property
    def symmetric(self) -> bool:
        """Whether the error of this object is ADD-S."""
        return len(self.symmetries) > 1

    @property
    def extents(self) -> np.ndarray:
        """Side lengths of the axis-aligned bounding box, (3,)."""
        return np.ptp(self.vertices, axis=0)
