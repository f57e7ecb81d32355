"""An image of a set of objects with their names."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from trimesh.remesh import subdivide_to_size

from ..object_model import ObjectModel
from ..texture import sample_texture

_COLUMNS = 5
_SIZE = 2.4
"""Of each object's image, inches."""
_AZIMUTH, _ELEVATION = 40.0, 25.0
"""Of the camera, degrees; azimuth 0 looks from +x, 90 from +y."""
_LIGHT = LightSource(azdeg=40, altdeg=55)
_MAX_EDGE = 0.02
"""Of the triangles that are drawn, each in one color, in diameters and in sides of the texture."""


def draw_contact_sheet(objects: Mapping[str, ObjectModel]) -> bytes:
    """Draws every object upright, each as large as fits, in parallel projection.

    Returns:
        A PNG; the same objects and versions of the libraries give the same bytes.
    """
    columns = min(_COLUMNS, len(objects))
    rows = -(-len(objects) // _COLUMNS)
    figure = Figure(figsize=(_SIZE * columns, _SIZE * rows), facecolor=(0.90, 0.90, 0.88))
    for number, (name, model) in enumerate(objects.items()):
        row, column = divmod(number, columns)
        place = (column / columns, 1 - (row + 1) / rows, 1 / columns, 1 / rows)
        axes: Any = figure.add_axes(place, projection="3d", proj_type="ortho", facecolor="none")
        corners = np.concatenate([model.vertices / model.diameter, model.uv], axis=1)
        corners, faces = subdivide_to_size(corners, model.faces, _MAX_EDGE, max_iter=20)
        colors = sample_texture(model.texture, corners[faces, 3:].mean(axis=1))
        triangles = Poly3DCollection(
            corners[faces, :3],
            facecolors=colors,
            edgecolors=colors,  # hides the seams that antialiasing leaves
            linewidths=0.3,
            shade=True,
            lightsource=_LIGHT,
        )
        axes.add_collection3d(triangles)
        low, high = corners[:, :3].min(axis=0), corners[:, :3].max(axis=0)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        axes.set_box_aspect(high - low)
        axes.view_init(_ELEVATION, _AZIMUTH)
        axes.set_axis_off()
        figure.text(place[0] + 0.03 / columns, place[1] + 0.97 / rows, name, va="top")
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=100)
    return content.getvalue()
