"""The table of scene kinds.

A new kind is one row here and one function that arranges it. Importing this does not import the
simulator, so that command lines can list the kinds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Literal


@dataclass(frozen=True)
class SceneKind:
    """One kind of scene.

    Attributes:
        arranger: ``module:function`` of this folder that arranges such a scene, see
            :class:`~.scene.ArrangementRequest`.
        object_count: minimum and maximum number of objects besides the target.
        shape_count: minimum and maximum number of plain shapes.
        min_path_visibility: visible fraction of the target along a hand-held camera's path, where
            possible.
        all_targets: whether every object is a target.
    """

    arranger: str
    object_count: tuple[int, int]
    shape_count: tuple[int, int]
    min_path_visibility: float
    all_targets: bool = False

    def load_arranger(self) -> Callable:
        """Imports and returns the function that arranges such a scene."""
        module, function = self.arranger.split(":")
        return getattr(import_module(f".{module}", __package__), function)


SCENE_KINDS = {
    # Light clutter, the target mostly unoccluded.
    "linemod": SceneKind("clutter:place_unoccluded", (3, 7), (0, 4), 0.6),
    # Dense clutter; the target's visibility is distributed as in LM-O.
    "clutter": SceneKind("clutter:place_occluded", (5, 8), (2, 5), 0.1),
    # The target stands between tall props and close neighbors; its visibility in the reference view
    # is distributed as in LM-O, but it is occluded from many other sides.
    "occlusion": SceneKind("clutter:place_surrounded", (5, 8), (4, 7), 0.1),
    # Dense clutter of eight objects, all upright; the visibility of all is distributed as in LM-O.
    "heap": SceneKind("heap:place_heap", (7, 7), (0, 2), 0.0, all_targets=True),
}

SCENE_MIXTURES = {"mixed": ("linemod", "clutter"), "all": ("linemod", "clutter", "heap")}
"""Mixtures of several kinds, which a dataset's scenes alternate between (round-robin)."""

# The choices of command lines; type checkers do not support a computed Literal.
if TYPE_CHECKING:
    SceneKindName = str
    SceneMixtureName = str
else:
    SceneKindName = Literal[tuple(SCENE_KINDS)]
    SceneMixtureName = Literal[(*SCENE_KINDS, *SCENE_MIXTURES)]
