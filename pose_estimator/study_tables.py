"""From outcomes to the records of results.json: every number of the report.

Intervals are of 95 percent, from a bootstrap over sequences (``intervals``). Means over objects
count every object the same, means over gaps every gap.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from .intervals import Estimate, clustered_mean
from .metrics import CORRECT
from .study_log import PairOutcome
from .study_units import BEST_GAP, DEFAULT_WEIGHTS, Unit

Record = dict[str, Any]

NEAR = 0.03
"""Distance in metres below which a keypoint counts as found."""

DISTANCE_STEP = 0.1
"""Width in metres of the classes of camera distance."""

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
            for against in ("single", "early", "late", "rgbd"):
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
    gaps = sorted({o.gap for o in outcomes})
    records = []
    for metric, (unit, measure) in MEASURES.items():
        for gap in gaps:
            at_gap = [o for o in outcomes if o.gap == gap]
            for name in dict.fromkeys(o.object_name for o in at_gap):
                mine = [o for o in at_gap if o.object_name == name]
                records.append(_record(metric, unit, _mean(mine, measure), object=name, gap=gap))
            mean = _mean(at_gap, measure, _object_name)
            records.append(_record(metric, unit, mean, object="mean", gap=gap))
        mean = _mean(outcomes, measure, lambda o: (o.gap, o.object_name))
        records.append(_record(metric, unit, mean, object="mean", gap="mean"))
    for gap in gaps:
        median = float(np.median([o.keypoint_distance for o in outcomes if o.gap == gap]))
        records.append(
            {"metric": "keypoint_distance_median", "value": median, "unit": "m", "gap": gap}
        )
    records += _by_distance([o for o in outcomes if o.gap == BEST_GAP])
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
        by_object = _object_name if name == "mean" else None
        found = _mean(group, lambda o: float(np.mean(np.array(o.distances) < NEAR)), by_object)
        tags = {"object": name, "gap": BEST_GAP, "distance": round((step + 0.5) * DISTANCE_STEP, 3)}
        records.append(_record("keypoint_recall", "", found, **tags))
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
            unit, measure = MEASURES[metric]
            records.append(
                _record(f"{metric}_difference", unit, _difference(pairs, measure), gap=gap)
                | dict(tags)
            )
    return records


def solver_records(outcomes: Sequence[PairOutcome], tags: Mapping[str, Any]) -> list[Record]:
    """Recall had the pose been solved from the same keypoints by another solver."""
    records: list[Record] = []
    solved = [o for o in outcomes if o.solver_errors]
    for gap in sorted({o.gap for o in solved}):
        group = [o for o in solved if o.gap == gap]
        for solver in group[0].solver_errors:
            recall = _mean(group, partial(_correct_by, solver), _object_name)
            records.append(_record("solver_recall", "", recall, solver=solver, gap=gap))
            if solver != "soft":
                gain = _mean(group, partial(_soft_gain, solver), _object_name)
                pair = {"solver": "soft", "against": solver, "gap": gap}
                records.append(_record("solver_recall_difference", "", gain, **pair))
    return [record | dict(tags) for record in records]


def _correct_by(solver: str, outcome: PairOutcome) -> float:
    return float(outcome.solver_errors[solver] < CORRECT)


def _soft_gain(solver: str, outcome: PairOutcome) -> float:
    return _correct_by("soft", outcome) - _correct_by(solver, outcome)


def _object_name(outcome: PairOutcome) -> str:
    return outcome.object_name


def noise_records(outcomes: Sequence[PairOutcome], tags: Mapping[str, Any]) -> list[Record]:
    """What a method reaches with an inexact relative pose; ``tags`` say how inexact."""
    records = []
    for metric in ("add_s_recall", "keypoint_distance"):
        unit, measure = MEASURES[metric]
        mean = _mean(outcomes, measure, _object_name)
        records.append(_record(f"noise_{metric}", unit, mean, **tags))
    return records


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
        unit, measure = MEASURES[metric]
        mean = _mean(outcomes, measure, _object_name)
        records.append(_record(f"training_{metric}", unit, mean, **tags))
        if pairs:
            matched = _mean([ours for ours, _ in pairs], measure, _object_name)
            baseline = {**tags, "training": DEFAULT_WEIGHTS, "paired_with": tags["training"]}
            records.append(_record(f"training_{metric}", unit, matched, **baseline))
            records.append(
                _record(f"training_{metric}_difference", unit, _difference(pairs, measure), **tags)
            )
    return records


def _matched(
    first: Iterable[PairOutcome], second: Iterable[PairOutcome]
) -> list[tuple[PairOutcome, PairOutcome]]:
    """Outcomes of the same object in the same pair of views."""
    others = {outcome.key: outcome for outcome in second}
    return [(outcome, others[outcome.key]) for outcome in first if outcome.key in others]


def _mean(
    outcomes: Sequence[PairOutcome],
    measure: Callable[[PairOutcome], float],
    groups: Callable[[PairOutcome], Hashable] | None = None,
) -> Estimate:
    return clustered_mean(
        [measure(o) for o in outcomes],
        [o.scene_id for o in outcomes],
        None if groups is None else [groups(o) for o in outcomes],
    )


def _difference(
    pairs: Sequence[tuple[PairOutcome, PairOutcome]], measure: Callable[[PairOutcome], float]
) -> Estimate:
    """Mean over the objects of the mean difference."""
    return clustered_mean(
        [measure(a) - measure(b) for a, b in pairs],
        [a.scene_id for a, _ in pairs],
        [a.object_name for a, _ in pairs],
    )


def _record(metric: str, unit: str, estimate: Estimate, **tags: Any) -> Record:
    """A record; it has no ``low`` and ``high`` where there is no interval."""
    ends = {"low": estimate.low, "high": estimate.high} if estimate.low is not None else {}
    return {
        "metric": metric,
        "value": estimate.value,
        "unit": unit,
        **ends,
        "n": estimate.n,
        "sequences": estimate.sequences,
        **tags,
    }
