"""Our models of the thirteen LineMOD objects, as solids with LineMOD's numbers and sizes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from . import animals, household, tools
from .solids import Solid


@dataclass(frozen=True)
class Blueprint:
    """What it takes to build one object.

    Attributes:
        obj_id: LineMOD's number.
        solid: makes the shape and its colors.
        extents: sides of the bounding box (m), (x, y, z).
        diameter: largest distance between two surface points (m).
        symmetric: whether half a turn about z must change nothing.
    """

    obj_id: int
    solid: Callable[[], Solid]
    extents: tuple[float, float, float]
    diameter: float
    symmetric: bool = False


BLUEPRINTS: dict[str, Blueprint] = {
    "ape": Blueprint(1, animals.ape, (0.07587, 0.07760, 0.09177), 0.102099),
    "benchvise": Blueprint(2, tools.benchvise, (0.21567, 0.12186, 0.21941), 0.247506),
    "cam": Blueprint(4, household.cam, (0.13666, 0.14303, 0.10050), 0.172492),
    "can": Blueprint(5, household.can, (0.10079, 0.18180, 0.19373), 0.201404),
    "cat": Blueprint(6, animals.cat, (0.06701, 0.12763, 0.11746), 0.154546),
    "driller": Blueprint(8, tools.driller, (0.22948, 0.07547, 0.20800), 0.261472),
    "duck": Blueprint(9, animals.duck, (0.10443, 0.07741, 0.08570), 0.108999),
    "eggbox": Blueprint(10, household.eggbox, (0.15018, 0.10708, 0.06924), 0.164628, True),
    "glue": Blueprint(11, household.glue, (0.03672, 0.07787, 0.17282), 0.175889, True),
    "holepuncher": Blueprint(12, tools.holepuncher, (0.10089, 0.10850, 0.09080), 0.145543),
    "iron": Blueprint(13, tools.iron, (0.25823, 0.11848, 0.14113), 0.278078),
    "lamp": Blueprint(14, household.lamp, (0.20315, 0.11775, 0.21312), 0.282601),
    "phone": Blueprint(15, household.phone, (0.09392, 0.14743, 0.18475), 0.212358),
}
"""The thirteen by name, in LineMOD's order."""
