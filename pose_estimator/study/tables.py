"""Turns outcomes into the records of results.json: every result of the report.

Intervals are of 95 percent, over sequences (``evaluation/intervals.py``). Means weight all objects,
and all gaps, equally.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from ..evaluation.intervals import clustered_mean
from ..evaluation.metrics import CORRECT
from ..evaluation.outcomes import MEASURES
from .log import PairOutcome
from .plan import DEFAULT_WEIGHTS, Run

Record = dict[str, Any]

MAX_KEYPOINT_ERROR = 0.03
"""Error below which a keypoint counts as found, m."""

BASELINE_BIN = 0.025
"""Width of the bins of the distance between the cameras, m."""

MAX_DISTANCE = 0.1
"""Limit of the capped keypoint distance, m: a few objects that are not found rule a plain mean."""

VISIBILITIES = ((0.1, 0.4), (0.4, 0.7), (0.7, 1.01))
"""Bins of the target's visible fraction in the reference view."""

COMPARED = {
    "mid": ("single", "early", "late", "rgbd"),
    "mid-pnp": ("pnp", "mid", "rgbd"),
    "late": ("early",),
}
"""Methods, each with those that it is compared with pair by pair."""

Grouping = Callable[[PairOutcome], Hashable]

_object_name = attrgetter("object_name")


def tables(outcomes: Mapping[Run, Sequence[PairOutcome]]) -> list[Record]:
    """Returns the records of all runs."""
    records: list[Record] = []
    main = {(run.test, run.method): o for run, o in outcomes.items() if run.part == "main"}
    for (scene, method), found in main.items():
        tags = {"scene": scene, "method": method}
        records += method_records(found, tags) + solver_records(found, tags)
        for against in COMPARED.get(method, ()):
            other = main.get((scene, against), [])
            records += difference_records(found, other, {**tags, "against": against})
    for run, found in outcomes.items():
        tags = {"scene": run.test, "method": run.method, "training": run.training}
        if run.part == "training":
            records += training_records(found, main.get((run.test, run.method), []), tags)
        elif run.part == "noise":
            errors = {"rotation_deg": run.rotation, "translation": run.translation}
            records += noise_records(found, {**tags, **errors})
    return records


def method_records(outcomes: Sequence[PairOutcome], tags: Mapping[str, Any]) -> list[Record]:
    """Returns the results of one method on one test: by object and gap, and the means."""
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
        distances = np.array([o.keypoint_distance for o in at_gap])
        median = {"value": float(np.median(distances)), "unit": "m"}
        records.append({"metric": "keypoint_distance_median", **median, "gap": gap})
        capped = np.minimum(distances, MAX_DISTANCE)
        records.append(
            _record("capped_keypoint_distance", "m", capped, at_gap, _object_name, gap=gap)
        )
        for low, high in VISIBILITIES:
            seen = [o for o in at_gap if low <= o.visibility < high]
            if seen:
                bins = {"gap": gap, "visibility": low}
                records.append(_mean("add_s_recall", seen, None, "visibility_", **bins))
    records += _recall_by_baseline(outcomes)
    return [record | dict(tags) for record in records]


def _recall_by_baseline(outcomes: Sequence[PairOutcome]) -> list[Record]:
    """Computes the share of keypoints found, by object and distance between the cameras."""
    bins: dict[tuple[str, int], list[PairOutcome]] = {}
    for outcome in outcomes:
        step = int(outcome.camera_baseline // BASELINE_BIN)
        for name in (outcome.object_name, "mean"):
            bins.setdefault((name, step), []).append(outcome)
    records = []
    for (name, step), group in sorted(bins.items()):
        found = [float(np.mean(np.array(o.distances) < MAX_KEYPOINT_ERROR)) for o in group]
        by = _object_name if name == "mean" else None
        tags = {"object": name, "baseline": round((step + 0.5) * BASELINE_BIN, 4)}
        records.append(_record("keypoint_recall", "", found, group, by, **tags))
    return records


def difference_records(
    first: Sequence[PairOutcome], second: Sequence[PairOutcome], tags: Mapping[str, Any]
) -> list[Record]:
    """Returns the differences in recall and distance, first minus second, on the same pairs."""
    records = []
    for gap in sorted({o.gap for o in first}):
        pairs = _matched([o for o in first if o.gap == gap], second)
        for metric in ("add_s_recall", "keypoint_distance") if pairs else ():
            records.append(_difference(metric, pairs, gap=gap) | dict(tags))
    return records


def solver_records(outcomes: Sequence[PairOutcome], tags: Mapping[str, Any]) -> list[Record]:
    """Returns the recall of each solver on the same keypoints, and Soft RANSAC's gain."""
    records: list[Record] = []
    solved = [o for o in outcomes if o.solver_errors]
    for gap in sorted({o.gap for o in solved}):
        group = [o for o in solved if o.gap == gap]
        correct = {
            solver: np.array([float(o.solver_errors[solver] < CORRECT) for o in group])
            for solver in group[0].solver_errors
        }
        for solver, values in correct.items():
            metric, names = "solver_recall", {"solver": solver, "gap": gap}
            records.append(_record(metric, "", values, group, _object_name, **names))
            if solver != "soft":
                metric, gain = "solver_recall_difference", correct["soft"] - values
                names = {"solver": "soft", "against": solver, "gap": gap}
                records.append(_record(metric, "", gain, group, _object_name, **names))
    return [record | dict(tags) for record in records]


def noise_records(outcomes: Sequence[PairOutcome], tags: Mapping[str, Any]) -> list[Record]:
    """Returns the results of a method with an inexact relative pose."""
    return [
        _mean(metric, outcomes, _object_name, "noise_", **tags)
        for metric in ("add_s_recall", "keypoint_distance")
    ]


def training_records(
    outcomes: Sequence[PairOutcome], baseline: Sequence[PairOutcome], tags: Mapping[str, Any]
) -> list[Record]:
    """Returns the results of other weights, and the gain of the default ones on the same pairs.

    Args:
        outcomes: with the other weights.
        baseline: with the default ones.
        tags: ``method``, ``scene`` and ``training``; the records of the default weights have the
            latter as ``paired_with``.
    """
    records = []
    for gap in sorted({o.gap for o in outcomes}):
        mine = [o for o in outcomes if o.gap == gap]
        pairs, own = _matched(baseline, mine), {**tags, "gap": gap}
        for metric in ("add_s_recall", "keypoint_distance"):
            records.append(_mean(metric, mine, _object_name, "training_", **own))
            if pairs:
                paired = {**own, "training": DEFAULT_WEIGHTS, "paired_with": tags["training"]}
                matched = [ours for ours, _ in pairs]
                records.append(_mean(metric, matched, _object_name, "training_", **paired))
                records.append(_difference(metric, pairs, "training_", **own))
    return records


def _matched(
    first: Iterable[PairOutcome], second: Iterable[PairOutcome]
) -> list[tuple[PairOutcome, PairOutcome]]:
    """Matches outcomes of the same object in the same pair of views."""
    others = {outcome.key: outcome for outcome in second}
    return [(outcome, others[outcome.key]) for outcome in first if outcome.key in others]


def _mean(
    metric: str, outcomes: Sequence[PairOutcome], by: Grouping | None, part: str = "", **tags: Any
) -> Record:
    """Returns the record of a metric's mean; ``part`` of the study is its prefix."""
    unit, measure = MEASURES[metric]
    values = [measure(o) for o in outcomes]
    return _record(f"{part}{metric}", unit, values, outcomes, by, **tags)


def _difference(
    metric: str, pairs: Sequence[tuple[PairOutcome, PairOutcome]], part: str = "", **tags: Any
) -> Record:
    """Returns the record of the mean over the objects of the mean difference."""
    unit, measure = MEASURES[metric]
    values, first = [measure(a) - measure(b) for a, b in pairs], [a for a, _ in pairs]
    return _record(f"{part}{metric}_difference", unit, values, first, _object_name, **tags)


def _record(
    metric: str,
    unit: str,
    values: Sequence[float] | np.ndarray,
    outcomes: Sequence[PairOutcome],
    by: Grouping | None,
    **tags: Any,
) -> Record:
    """Returns the record of the mean over groups (``by``) of the mean of values within each.

    Without an interval it has no ``low`` and ``high``.
    """
    groups = None if by is None else [by(o) for o in outcomes]
    rate = metric.removesuffix("_difference")
    bounds = None
    if rate.endswith(("recall", "over_diameter")):
        bounds = (0, 1) if rate == metric else (-1, 1)
    mean = clustered_mean(values, [o.scene_id for o in outcomes], groups, bounds=bounds)
    interval = {"low": mean.low, "high": mean.high} if mean.low is not None else {}
    counts = {"n": mean.n, "sequences": mean.sequences}
    return {"metric": metric, "value": mean.value, "unit": unit, **interval, **counts, **tags}
