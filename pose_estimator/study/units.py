"""What a study runs: which method gets which pairs of which test, with which errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.pose_noise import perturb_relative_pose
from ..bop.dataset import BopPair
from ..evaluation.evaluate_pairs import target_pairs
from ..methods import METHOD_TABLE

ONE_VIEW = frozenset(m.name for m in METHOD_TABLE.values() if m.views == 1)
"""Methods that look at the reference view only."""

GAPS = (1, 5, 10)
"""Frames between the two views."""

BEST_GAP = 10
"""The gap of the tables by object, as in the paper."""

TESTS = ("linemod", "occlusion")

DEFAULT_WEIGHTS = ""
"""The weights that the study is about; other trainings have a name."""

NOISY = "pose noise"
"""Weights trained with errors of the relative pose."""

NO_POSE_LOSS = "no pose loss"
"""Weights trained without the loss on the pose itself."""

ROTATIONS = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Errors of the relative pose in degrees."""

TRANSLATIONS = (0.0, 0.0025, 0.005, 0.0075, 0.010)
"""The same in meters."""

NOISE = tuple(
    dict.fromkeys(
        [*zip(ROTATIONS, TRANSLATIONS, strict=True)]
        + [(rotation, 0.0) for rotation in ROTATIONS]
        + [(0.0, translation) for translation in TRANSLATIONS]
    )
)
"""Degrees and meters: both together, and each alone."""


def has_both_errors(record: Mapping[str, Any]) -> bool:
    """Whether a record is of both errors together: 5 mm for each degree, or none of either."""
    return abs(record["rotation_deg"] / 2 - record["translation"] / 0.01) < 1e-9


_T = TypeVar("_T")


@dataclass(frozen=True)
class Unit:
    """One method on one test: what is measured, kept and resumed as a whole.

    Attributes:
        part: of the study: ``main``, ``training`` (other weights) or ``noise`` (inexact poses).
        test: ``linemod`` or ``occlusion``.
        method: see ``pose_estimator.METHODS``.
        training: which weights, by the name that the report gives them.
        gaps: frames between the views.
        per_object: at most so many pairs for each object and gap, spread evenly; 0 = all.
        per_gap: at most so many pairs for each gap in all; 0 = all.
        rotation: error of the relative pose that the method is given, degrees.
        translation: the same, meters.
    """

    part: Literal["main", "training", "noise"]
    test: str
    method: str
    training: str = DEFAULT_WEIGHTS
    gaps: tuple[int, ...] = GAPS
    per_object: int = 0
    per_gap: int = 0
    rotation: float = 0.0
    translation: float = 0.0

    @property
    def name(self) -> str:
        """Of its file."""
        parts = [self.part, self.test, self.method]
        if self.training:
            parts.append(self.training.replace(" ", "-"))
        if self.part == "noise":
            parts.append(f"{self.rotation:g}deg-{1000 * self.translation:g}mm")
        return "_".join(parts)


def choose_pairs(
    unit: Unit, pairs: Sequence[BopPair], objects: Mapping[str, ObjectModel]
) -> list[tuple[BopPair, str]]:
    """The pairs and targets of a unit, scene by scene."""
    groups: dict[tuple[int, str], list[tuple[BopPair, str]]] = {}
    for pair, name in target_pairs(pairs, objects):
        if pair.gap in unit.gaps:
            groups.setdefault((pair.gap, name), []).append((pair, name))
    by_gap: dict[int, list[tuple[BopPair, str]]] = {}
    for (gap, _), group in groups.items():
        by_gap.setdefault(gap, []).extend(_spread(group, unit.per_object))
    chosen = [work for group in by_gap.values() for work in _spread(group, unit.per_gap)]
    order = {name: number for number, name in enumerate(objects)}
    return sorted(
        chosen,
        key=lambda work: (
            work[0].scene_id, work[0].ref_image_id, order[work[1]], work[0].second_image_id
        ),
    )  # fmt: skip


def _spread(group: Sequence[_T], count: int) -> list[_T]:
    """At most ``count`` of a list, evenly; all for 0."""
    count = min(count or len(group), len(group))
    return [group[(2 * i + 1) * len(group) // (2 * count)] for i in range(count)]


def perturbed_pose(unit: Unit, pair: BopPair, seed: int) -> np.ndarray:
    """T_second_ref (4, 4) as the method is given it: off by the unit's angle and distance.

    The directions are random and depend on the pair alone, so that units differ in size only.
    """
    if not unit.rotation and not unit.translation:
        return pair.T_second_ref
    rng = np.random.default_rng([seed, pair.scene_id, pair.ref_image_id, pair.second_image_id])
    return perturb_relative_pose(pair.T_second_ref, unit.rotation, unit.translation, rng)


def plan(
    methods: Sequence[str],
    trainings: Sequence[str],
    *,
    per_object: int = 0,
    noise_per_object: int = 0,
    per_gap: int = 0,
) -> Iterator[Unit]:
    """Everything that a study measures, the tables first.

    Args:
        methods: which to run.
        trainings: which weights there are, ``DEFAULT_WEIGHTS`` among them.
        per_object: pairs for each object and gap; 0 = all.
        noise_per_object: pairs for each object under errors of the relative pose; 0 = all.
        per_gap: pairs for each gap in all, for a quick run, which also takes the ends of the errors
            only; 0 = all.
    """
    for test in TESTS:
        for method in methods:
            yield Unit("main", test, method, per_object=per_object, per_gap=per_gap)
    if "mid" in methods:
        for training in trainings:
            if training != DEFAULT_WEIGHTS:
                for test in TESTS:
                    yield Unit("training", test, "mid", training, (BEST_GAP,), per_object, per_gap)
    # Triangulation learns nothing from a wrong pose, so `late` has no second training.
    noisy = [("mid", DEFAULT_WEIGHTS), ("mid", NOISY), ("late", DEFAULT_WEIGHTS)]
    ends = [(r, t) for r, t in NOISE if {r, t} <= {0.0, ROTATIONS[-1], TRANSLATIONS[-1]}]
    for rotation, translation in ends if per_gap else NOISE:
        for method, training in noisy:
            if method in methods and training in trainings:
                yield Unit(
                    "noise", "linemod", method, training, (BEST_GAP,), noise_per_object,
                    per_gap, rotation, translation,
                )  # fmt: skip
