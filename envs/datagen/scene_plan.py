"""Kind, target, frames and pairs of each scene of a generated dataset.

The images of a scene are views on the sphere around its target, the first of them the reference
view; or pairs of a stereo rig; or frames of a hand-held sequence with several reference views.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...assets import OBJECT_NAMES
from ...assets.object_model import ObjectModel
from ...core.errors import InputError
from ...pose_estimator.bop.objects import load_objects
from ..simulation.scene_kinds import SCENE_MIXTURES
from ..simulation.trajectories.stereo import rig_pairs
from .config import GenerateConfig


@dataclass(frozen=True)
class ScenePlan:
    """What to render of one scene.

    Attributes:
        kind: a name of :data:`~.scene_kinds.SCENE_KINDS`.
        target: name of the target object; in some kinds of scenes, all objects are targets.
        length: frames of the hand-held sequence, else None.
        frames: numbers of the frames that are rendered, ascending.
        pairs: numbers of reference view and second view.
        stereo: whether left and right views of a rig alternate.
    """

    kind: str
    target: str
    length: int | None
    frames: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]
    stereo: bool = False


def dataset_objects(config: GenerateConfig) -> dict[str, ObjectModel]:
    """Loads all objects of a dataset by name, the distractors last.

    Raises:
        InputError: if a distractor is a folder of several, or as ``load_objects``.
    """
    if not config.distractors:
        return load_objects(config.objects or None, config.unit)
    if len(load_objects(config.distractors, config.unit)) != len(config.distractors):
        raise InputError("distractors must be named one by one, not as a folder of several")
    return load_objects([*(config.objects or OBJECT_NAMES), *config.distractors], config.unit)


def target_names(config: GenerateConfig, names: Sequence[str]) -> Sequence[str]:
    """Returns the targets among the objects of a dataset, which end with the distractors."""
    return names[: len(names) - len(config.distractors)]


def plan_scene(config: GenerateConfig, scene_id: int, names: Sequence[str]) -> ScenePlan:
    """Plans scene ``scene_id`` of a dataset with objects ``names``: kinds and targets alternate."""
    targets = target_names(config, names)
    target = targets[scene_id % len(targets)]
    kinds = SCENE_MIXTURES.get(config.scene, (config.scene,))
    cycle = scene_id // len(targets)
    kind = kinds[cycle % len(kinds)]
    if config.sampling == "stereo":
        frames = tuple(range(config.views))
        return ScenePlan(kind, target, None, frames, rig_pairs(config.views), stereo=True)
    hand_held = config.sampling == "hand-held"
    length, references = config.views, config.references
    if config.sampling == "mixed":
        hand_held = cycle // len(kinds) % 2 == 1
        length, references = 1 + max(config.gaps), 1
    if not hand_held:
        pairs = tuple((0, second) for second in range(1, config.views))
        return ScenePlan(kind, target, None, tuple(range(config.views)), pairs)
    pairs = tuple(
        (first, first + gap)
        for first in reference_frames(length, config.gaps, references)
        for gap in config.gaps
    )
    frames = tuple(sorted({frame for pair in pairs for frame in pair}))
    return ScenePlan(kind, target, length, frames, pairs)


def reference_frames(length: int, gaps: Sequence[int], count: int) -> list[int]:
    """Returns ``count`` (0: all) evenly spread frames that have a second view at every gap."""
    possible = length - max(gaps)
    count = min(count or possible, possible)
    return [int(frame) for frame in np.linspace(0, possible - 1, count).round()]
