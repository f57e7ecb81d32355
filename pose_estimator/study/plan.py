"""The runs of a study: each method, the pairs of each test, and errors of the relative pose."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ...assets.object_model import ObjectModel
from ...core.pose_noise import perturb_relative_pose
from ..bop.dataset import BopPair
from ..evaluation.evaluate_pairs import target_pairs

GAPS = (1, 5, 10)
"""Frames between the two views."""

BEST_GAP = 10
"""The gap of the tables by object, as in the paper."""

TESTS = ("linemod", "occlusion")

DEFAULT_WEIGHTS = ""
"""Name of the weights that the study is about; other trainings have a name of their own."""

NOISY = "pose-noise"
"""Weights trained with errors of the relative pose."""

ROTATIONS = (0.0, 0.5, 1.0, 1.5, 2.0)
"""Errors of the relative pose, degrees."""

TRANSLATIONS = (0.0, 0.0025, 0.005, 0.0075, 0.010)
"""Errors of the relative pose, meters."""

NOISE = tuple(
    dict.fromkeys(
        [*zip(ROTATIONS, TRANSLATIONS, strict=True)]
        + [(rotation, 0.0) for rotation in ROTATIONS]
        + [(0.0, translation) for translation in TRANSLATIONS]
    )
)
"""Pairs of errors (degrees, meters): both together, and each alone."""


def has_both_errors(record: Mapping[str, Any]) -> bool:
    """Whether a record has both errors: 5 mm for each degree, or none of either."""
    return abs(record["rotation_deg"] / 2 - record["translation"] / 0.01) < 1e-9


Work = tuple[BopPair, str]
"""A pair of views and the name of the object to estimate."""


@dataclass(frozen=True)
class Run:
    """One method on one test, logged in one file and resumable.

    Attributes:
        part: of the study: ``main``, ``training`` (other weights) or ``noise`` (inexact poses).
        training: which weights, by their name in the report.
        gaps: frames between the views.
        per_object: maximum number of pairs for each object and gap, spread evenly; 0 = all.
        per_gap: maximum number of pairs for each gap; 0 = all.
        rotation, translation: error of the relative pose that the method is given, degrees and
            meters.
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
        """Stem of its file."""
        parts = [self.part, self.test, self.method]
        if self.training:
            parts.append(self.training.replace(" ", "-"))
        if self.part == "noise":
            parts.append(f"{self.rotation:g}deg-{1000 * self.translation:g}mm")
        return "_".join(parts)


def choose_pairs(
    run: Run, pairs: Sequence[BopPair], objects: Mapping[str, ObjectModel]
) -> list[Work]:
    """Returns the pairs and targets of a run, ordered by scene."""
    by_gap: dict[int, dict[str, list[Work]]] = {}
    for pair, name in target_pairs(pairs, objects):
        if pair.gap in run.gaps:
            by_gap.setdefault(pair.gap, {}).setdefault(name, []).append((pair, name))
    chosen: list[Work] = []
    for groups in by_gap.values():
        at_gap = [work for group in groups.values() for work in _spread(group, run.per_object)]
        chosen += _spread(at_gap, run.per_gap)
    names = list(objects)

    def order(work: Work) -> tuple[int, ...]:
        pair, name = work
        return pair.scene_id, pair.ref_image_id, names.index(name), pair.second_image_id

    return sorted(chosen, key=order)


def _spread(group: Sequence[Work], count: int) -> list[Work]:
    """Returns at most ``count`` elements, evenly spaced; all for 0."""
    count = min(count or len(group), len(group))
    return [group[(2 * i + 1) * len(group) // (2 * count)] for i in range(count)]


def perturbed_pose(run: Run, pair: BopPair, seed: int) -> np.ndarray:
    """Returns T_second_ref (4, 4) with the run's rotation and translation error.

    The directions are random and depend on the pair alone, so runs differ in magnitude only.
    """
    if not run.rotation and not run.translation:
        return pair.T_second_ref
    rng = np.random.default_rng([seed, pair.scene_id, pair.ref_image_id, pair.second_image_id])
    return perturb_relative_pose(pair.T_second_ref, run.rotation, run.translation, rng)


def plan(
    methods: Sequence[str],
    trainings: Sequence[str],
    *,
    per_object: int = 0,
    noise_per_object: int = 0,
    other_per_object: int = 0,
    per_gap: int = 0,
) -> Iterator[Run]:
    """Yields every run of a study, those of the tables first.

    ``trainings`` are names of weights. ``other_per_object`` is ``per_object`` of other weights than
    the default ones, ``noise_per_object`` under errors of the relative pose; with ``per_gap`` only
    the extreme errors are used.
    """
    for test in TESTS:
        for method in methods:
            yield Run("main", test, method, per_object=per_object, per_gap=per_gap)
    if "mid" in methods:
        for training in trainings:
            if training != DEFAULT_WEIGHTS:
                for test in TESTS:
                    yield Run("training", test, "mid", training, GAPS, other_per_object, per_gap)
    # `late` has no second training: triangulation learns nothing from an inexact pose.
    noisy = [("mid", DEFAULT_WEIGHTS), ("mid", NOISY), ("late", DEFAULT_WEIGHTS)]
    extremes = [(r, t) for r, t in NOISE if {r, t} <= {0.0, ROTATIONS[-1], TRANSLATIONS[-1]}]
    limits = ((BEST_GAP,), noise_per_object, per_gap)
    for errors in extremes if per_gap else NOISE:
        for method, training in noisy:
            if method in methods and training in trainings:
                yield Run("noise", "linemod", method, training, *limits, *errors)
