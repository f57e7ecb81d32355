"""From outcomes to the records of results.json: every number of the report.

Intervals are of 95 percent, from a bootstrap over sequences (``intervals``). Means over objects
count every object the same, means over gaps every gap.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from ..evaluation.intervals import clustered_mean
from ..evaluation.metrics import CORRECT
from ..methods import METHODS
from .log import PairOutcome
from .units import BEST_GAP, DEFAULT_WEIGHTS, Unit

Record = dict[str, Any]

NEAR = 0.03
"""Distance in meters below which a keypoint counts as found."""

DISTANCE_STEP = 0.1
"""Width in meters of the classes of camera distance."""

Grouping = Callable[[PairOutcome], Hashable]

_object_name = attrgetter("object_name")

MEASURES: Mapping[str, tuple[str, Callable[[PairOutcome], float]]] = {
    "add_s_recall": ("", lambda o: float(o.error < CORRECT)),
    "add_over_diameter": ("", lambda o: min(o.error, 1.0)),
    "keypoint_distance": ("m", lambda o: o.keypoint_distance),
}
"""Metric -> its unit, and its value for one outcome."""


def tables(outcomes: Mapping[Unit, Sequence[PairOutcome]]) -> list[Record]:
    """The records of all that was measured."""
    records: list[Record] = []
    main = {(unit.test, unit.method): o for unit, o in outcomes.items() if unit.part == "main"}
    for (scene, method), found in main.items():
        tags = {"scene": scene, "method": method}
        records += method_records(found, tags) + solver_records(found, tags)
        if method == "mid":
            for against in (other for other in METHODS if other != "mid"):
                other = main.get((scene, against), [])
                records += difference_records(found, other, {**tags, "against": against})
    for unit, found in outcomes.items():
        tags = {"scene": unit.test, "method": unit.method, "training": unit.training}
        if unit.part == "training":
            records += training_records(found, main.get((unit.test, unit.method), []), tags)
        elif unit.part == "noise":
            errors = {"rotation_deg": unit.rotation, "translation": unit.translation}
            records += noise_records(found, {**tags, **errors})
    return records


def method_records(outcomes: Sequence[PairOutcome], tags: Mapping[str, Any]) -> list[Record]:
    """What one method reaches on one test: by object and gap, and the means.

    Args:
        outcomes: of all gaps.
        tags: ``method`` and ``scene``.
    """
    by_gap = {g: [o for o in outcomes if o.gap == g] for g in sorted({o.gap for o in outcomes})}
    records = []
    for metric in MEASURES:
        for gap, at_gap in by_gap.items():
            for name in dict.fromkeys(o.object_name for o in at_gap):
                mine = [o for o in at_gap if o.object_name == name]
                records.append(_mean(metric, mine, None, object=name, gap=gap))
            records.append(_mean(metric, at_gap, _object_name, object="mean", gap=gap))
        by = attrgetter("gap", "object_name")
        records.append(_mean(metric, outcomes, by, object="mean", gap="mean"))
    for gap, at_gap in by_gap.items():
        median = float(np.median([o.keypoint_distance for o in at_gap]))
        records.append(
            {"metric": "keypoint_distance_median", "value": median, "unit": "m", "gap": gap}
        )
    records += _by_distance(by_gap.get(BEST_GAP, []))
    return [record | dict(tags) for record in records]


def _by_distance(outcomes: Sequence[PairOutcome]) -> list[Record]:
    """Share of the keypoints found, by object and by how far the camera is."""
    classes: dict[tuple[str, int], list[PairOutcome]] = {}
    for outcome in outcomes:
        step = int(outcome.camera_distance // DISTANCE_STEP)
        for name in (outcome.object_name, "mean"):
            classes.setdefault((name, step), []).append(outcome)
    records = []
    for (name, step), group in sorted(classes.items()):
        found = [float(np.mean(np.array(o.distances) < NEAR)) for o in group]
        by = _object_name if name == "mean" else None
        tags = {"object": name, "gap": BEST_GAP, "distance": round((step + 0.5) * DISTANCE_STEP, 3)}
        records.append(_record("keypoint_recall", "", found, group, by, **tags))
    return records


def difference_records(
    first: Sequence[PairOutcome], second: Sequence[PairOutcome], tags: Mapping[str, Any]
) -> list[Record]:
    """How much better (recall) or worse (distance) a method is than another on the same pairs.

    Args:
        first: one method's outcomes.
        second: the other's, which are taken away.
        tags: ``method``, ``against`` and ``scene``.
    """
    records = []
    for gap in sorted({o.gap for o in first}):
        pairs = _matched([o for o in first if o.gap == gap], second)
        for metric in ("add_s_recall", "keypoint_distance") if pairs else ():
            records.append(_difference(metric, pairs, gap=gap) | dict(tags))
    return records


def solver_records(outcomes: Sequence[PairOutcome], tags: Mapping[str, Any]) -> list[Record]:
    """Recall had the pose been solved from the same keypoints by another solver."""
    records: list[Record] = []
    solved = [o for o in outcomes if o.solver_errors]
    for gap in sorted({o.gap for o in solved}):
        group = [o for o in solved if o.gap == gap]
        correct = {
            solver: np.array([float(o.solver_errors[solver] < CORRECT) for o in group])
            for solver in group[0].solver_errors
        }
        for solver, values in correct.items():
            found = {"solver": solver, "gap": gap}
            records.append(_record("solver_recall", "", values, group, _object_name, **found))
            if solver != "soft":
                gain, metric = correct["soft"] - values, "solver_recall_difference"
                found = {"solver": "soft", "against": solver, "gap": gap}
                records.append(_record(metric, "", gain, group, _object_name, **found))
    return [record | dict(tags) for record in records]


def noise_records(outcomes: Sequence[PairOutcome], tags: Mapping[str, Any]) -> list[Record]:
    """What a method reaches with an inexact relative pose; ``tags`` say how inexact."""
    return [
        _mean(metric, outcomes, _object_name, "noise", **tags)
        for metric in ("add_s_recall", "keypoint_distance")
    ]


def training_records(
    outcomes: Sequence[PairOutcome], usual: Sequence[PairOutcome], tags: Mapping[str, Any]
) -> list[Record]:
    """What other weights reach, and how much more the default ones do on the same pairs.

    Args:
        outcomes: with the other weights.
        usual: with the default ones.
        tags: ``method``, ``scene`` and ``training``; the records of the default weights on the same
            pairs have the tag ``paired_with`` instead of the latter.
    """
    records = []
    pairs = _matched(usual, outcomes)
    for metric in ("add_s_recall", "keypoint_distance"):
        records.append(_mean(metric, outcomes, _object_name, "training", **tags))
        if pairs:
            baseline = {**tags, "training": DEFAULT_WEIGHTS, "paired_with": tags["training"]}
            matched = [ours for ours, _ in pairs]
            records.append(_mean(metric, matched, _object_name, "training", **baseline))
            records.append(_difference(metric, pairs, "training", **tags))
    return records


def _matched(
    first: Iterable[PairOutcome], second: Iterable[PairOutcome]
) -> list[tuple[PairOutcome, PairOutcome]]:
    """Outcomes of the same object in the same pair of views."""
    others = {outcome.key: outcome for outcome in second}
    return [(outcome, others[outcome.key]) for outcome in first if outcome.key in others]


def _mean(
    metric: str, outcomes: Sequence[PairOutcome], by: Grouping | None, part: str = "", **tags: Any
) -> Record:
    """The record of a measure's mean; ``part`` of the study begins its name."""
    unit, measure = MEASURES[metric]
    name = f"{part}_{metric}" if part else metric
    return _record(name, unit, [measure(o) for o in outcomes], outcomes, by, **tags)


def _difference(
    metric: str, pairs: Sequence[tuple[PairOutcome, PairOutcome]], part: str = "", **tags: Any
) -> Record:
    """The record of the mean over the objects of the mean difference."""
    unit, measure = MEASURES[metric]
    name = f"{part}_{metric}_difference" if part else f"{metric}_difference"
    values = [measure(a) - measure(b) for a, b in pairs]
    return _record(name, unit, values, [a for a, _ in pairs], _object_name, **tags)


def _record(
    metric: str,
    unit: str,
    values: Sequence[float] | np.ndarray,
    outcomes: Sequence[PairOutcome],
    by: Grouping | None,
    **tags: Any,
) -> Record:
    """The record of the mean of values, one for each outcome.

    It is the mean over the groups (``by``) of the mean within each, and has no ``low`` and ``high``
    where there is no interval.
    """
    groups = None if by is None else [by(o) for o in outcomes]
    estimate = clustered_mean(values, [o.scene_id for o in outcomes], groups)
    ends = {"low": estimate.low, "high": estimate.high} if estimate.low is not None else {}
    counts = {"n": estimate.n, "sequences": estimate.sequences}
    return {"metric": metric, "value": estimate.value, "unit": unit, **ends, **counts, **tags}
