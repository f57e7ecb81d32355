"""One part of a mesh file: triangles and their paint."""

from dataclasses import dataclass

import trimesh

from .paint import Paint


@dataclass(eq=False)
class Part:
    """Triangles that share one material.

    Attributes:
        mesh: geometry in the file's frame and unit; vertices are not merged.
        paint: its colors, by the indices of that mesh.
    """

    mesh: trimesh.Trimesh
    paint: Paint
