"""The one table of the kinds of scenes.

A new kind is one row here and one function that arranges it. Importing this imports no simulator,
so command lines can name the kinds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Literal


@dataclass(frozen=True)
class SceneKind:
    """What sets one kind of scene apart from the others.

    Attributes:
        arranger: ``module:function`` of this folder that arranges such a scene, see
            :class:`~.scene.ArrangementRequest`.
        object_count: fewest and most objects beside the target.
        shape_count: fewest and most plain shapes.
        min_path_visibility: visible fraction that the target keeps along a hand-held camera's path
            where that is possible.
        all_targets: whether every object is a target, not one alone.
    """

    arranger: str
    object_count: tuple[int, int]
    shape_count: tuple[int, int]
    min_path_visibility: float
    all_targets: bool = False

    def load_arranger(self) -> Callable:
        """The function that arranges such a scene."""
        module, function = self.arranger.split(":")
        return getattr(import_module(f".{module}", __package__), function)


SCENE_KINDS = {
    # Light clutter, the target nearly always in full view.
    "linemod": SceneKind("clutter:place_unoccluded", (3, 7), (0, 4), 0.6),
    # Dense clutter; the target's visibility is distributed as in LM-O.
    "clutter": SceneKind("clutter:place_occluded", (5, 8), (2, 5), 0.1),
    # The target stands between tall things and close neighbors; its visibility from the reference
    # camera is distributed as in LM-O too, but from many other sides it is hidden.
    "occlusion": SceneKind("clutter:place_surrounded", (5, 8), (4, 7), 0.1),
    # Eight objects close together, all upright; the visibility of all is distributed as in LM-O.
    "heap": SceneKind("heap:place_heap", (7, 7), (0, 2), 0.0, all_targets=True),
}

SCENE_MIXTURES = {"mixed": ("linemod", "clutter"), "all": ("linemod", "clutter", "heap")}
"""Names that stand for several kinds, which a dataset's scenes take round-robin."""

# The choices that a command line offers; type checkers cannot follow a computed Literal.
if TYPE_CHECKING:
    SceneKindName = str
    SceneMixtureName = str
else:
    SceneKindName = Literal[tuple(SCENE_KINDS)]
    SceneMixtureName = Literal[(*SCENE_KINDS, *SCENE_MIXTURES)]
