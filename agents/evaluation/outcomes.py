"""Outcomes of episodes and their statistics.

Intervals are over scenes, see ``pose_estimator/evaluation/intervals.py``. Policies see the same
scenes, so differences are paired: their intervals resample scenes, with both policies' outcomes
together (Efron and Tibshirani, *An Introduction to the Bootstrap*, chapter 8).
"""

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from ...pose_estimator.evaluation.intervals import (
    MIN_FREEDOM,
    QUANTILES,
    RESAMPLES,
    TOO_FEW,
    clustered_mean,
)

STAY = "stay"
"""Name of the estimate from the first view alone."""

ORACLE, REFERENCE_POLICY = "oracle", "max-baseline"
"""The upper bound, and the rule that trained policies are compared with."""

SUCCESS = 0.1
"""An estimate is correct if ADD(-S) is below this fraction of the object's diameter."""

VISIBILITY_BINS = ((0.0, 0.4), (0.4, 0.7), (0.7, 0.9), (0.9, 1.01))
"""Half-open intervals of the target's visible fraction in the reference view."""

Interval = tuple[float, float | None, float | None]
"""A value with the low and high end of its 95 percent interval; None for too few scenes."""

Bounds = tuple[int, int] | None
"""Of values, see ``clustered_mean``."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of one episode.

    Attributes:
        object_name: the target.
        add_over_diameter: ADD(-S) of the final estimate over the object's diameter.
        travel: camera travel, meters.
        visibility: visible fraction of the target in the reference view; NaN if unknown.
        baseline_deg: angle between the reference view and the newest.
        views: number of second views.
        scene: identifies the scene among those of one object; None: each outcome has its own.
    """

    object_name: str
    add_over_diameter: float
    travel: float
    visibility: float = math.nan
    baseline_deg: float = 0.0
    views: int = 1
    scene: int | None = None

    @property
    def capped(self) -> float:
        """min(ADD(-S) / diameter, 1), as in the reward."""
        return min(self.add_over_diameter, 1.0)

    @property
    def success(self) -> bool:
        """Whether ADD(-S) is below a tenth of the diameter."""
        return self.add_over_diameter < SUCCESS


def outcome_of(info: Mapping[str, Any], key: str, views: int) -> Outcome:
    """Reads an environment's info; ``key`` is ``add_first`` or ``add_second``."""
    truth = info["ground_truth"]
    return Outcome(
        object_name=str(info["object"]),
        add_over_diameter=float(truth[key]) / float(info["diameter"]),
        travel=float(info["travel"]),
        visibility=float(truth.get("visibility", math.nan)),
        baseline_deg=float(info.get("baseline_deg", 0.0)),
        views=views,
        scene=info.get("scene_seed"),
    )


def per_scene(results: Sequence[Outcome], value: Callable[[Outcome], float]) -> np.ndarray:
    """Averages a value over repetitions of each scene, in the order of the scenes."""
    groups: dict[Hashable, list[float]] = {}
    for scene, result in zip(_scenes(results), results, strict=True):
        groups.setdefault(scene, []).append(value(result))
    return np.array([np.mean(values) for values in groups.values()])


def _scenes(results: Sequence[Outcome]) -> list[Hashable]:
    """What is equal for repetitions of the same scene."""
    return [i if r.scene is None else (r.object_name, r.scene) for i, r in enumerate(results)]


def make_records(outcomes: Mapping[str, Sequence[Outcome]], scene: str) -> list[dict[str, Any]]:
    """Makes the records of a results file, with 95 percent intervals over scenes.

    For all objects (``object`` is ``mean``), each object, and each visibility bin (``visibility``
    is its lower end); then paired comparisons with ``max-baseline``. Records of too few scenes for
    an interval have no ``low`` and ``high``.
    """
    records = []
    for policy, results in outcomes.items():
        names = sorted({result.object_name for result in results})
        for name in ["mean", *names]:
            rows = [result for result in results if name in ("mean", result.object_name)]
            records += _records(rows, {"policy": policy, "scene": scene, "object": name})
        for low, high in VISIBILITY_BINS:
            rows = [result for result in results if low <= result.visibility < high]
            tags = {"policy": policy, "scene": scene, "object": "mean", "visibility": low}
            records += _records(rows, tags) if rows else []
    return records + _comparisons(outcomes, scene)


def _records(results: Sequence[Outcome], tags: Mapping[str, Any]) -> list[dict[str, Any]]:
    tags = {**tags, "n": len(per_scene(results, lambda r: r.views))}
    return [_record(metric, unit, interval, tags) for metric, unit, interval in statistics(results)]


def _record(metric: str, unit: str, interval: Interval, tags: Mapping[str, Any]) -> dict[str, Any]:
    value, low, high = interval
    ends = {} if low is None else {"low": low, "high": high}
    return {"metric": metric, "value": value, "unit": unit, **tags, **ends}


def statistics(results: Sequence[Outcome]) -> list[tuple[str, str, Interval]]:
    """Metrics with unit and interval."""
    scenes = _scenes(results)
    measures: list[tuple[str, str, Bounds, Callable[[Outcome], float]]] = [
        ("add_s_recall", "1", (0, 1), lambda r: r.success),
        ("add_over_diameter", "1", None, lambda r: r.add_over_diameter),
        ("capped_add_over_diameter", "1", (0, 1), lambda r: r.capped),
        ("travel", "m", None, lambda r: r.travel),
        ("second_views", "1", None, lambda r: r.views),
    ]
    return [
        (metric, unit, _mean([value(r) for r in results], scenes, bounds))
        for metric, unit, bounds, value in measures
    ]


def _comparisons(outcomes: Mapping[str, Sequence[Outcome]], scene: str) -> list[dict[str, Any]]:
    """Paired differences of every policy from ``max-baseline`` and the oracle."""
    if REFERENCE_POLICY not in outcomes:
        return []
    capped = {name: per_scene(rows, lambda r: r.capped) for name, rows in outcomes.items()}
    success = {name: per_scene(rows, lambda r: r.success) for name, rows in outcomes.items()}
    reference, oracle = capped[REFERENCE_POLICY], capped.get(ORACLE)
    tags = {"scene": scene, "object": "mean", "against": REFERENCE_POLICY, "n": len(reference)}
    records = []
    for policy in outcomes:
        # The difference from itself is 0 without doubt.
        bounds = (-1, 1) if policy != REFERENCE_POLICY else None
        found = {
            "add_s_recall_difference": _paired(success[policy] - success[REFERENCE_POLICY], bounds),
            "capped_difference": _paired(capped[policy] - reference),
        }
        if oracle is not None:
            closed = gap_closed(capped[policy], reference, oracle)
            found |= {"gap_closed": closed} if closed is not None else {}
            found["regret"] = _paired(capped[policy] - oracle)
        own = {"policy": policy, **tags}
        records += [_record(metric, "1", interval, own) for metric, interval in found.items()]
    return records


def gap_closed(policy: np.ndarray, reference: np.ndarray, oracle: np.ndarray) -> Interval | None:
    """Fraction of the gap in mean error between a reference policy and the oracle that is closed.

    Takes capped errors on the same scenes, (M,) each. None if reference and oracle are equal.
    """
    gap = reference.mean() - oracle.mean()
    if gap < 1e-9:
        return None
    closed = float((reference.mean() - policy.mean()) / gap)
    if len(policy) <= MIN_FREEDOM:
        return closed, None, None
    gaps, gains = (_resamples(len(policy)) @ (reference - other) for other in (oracle, policy))
    low, high = np.quantile(gains[gaps > 0] / gaps[gaps > 0], QUANTILES)
    return closed, float(low), float(high)


def _paired(differences: np.ndarray, bounds: Bounds = None) -> Interval:
    """Mean difference over scenes, with its interval."""
    return _mean(differences, range(len(differences)), bounds)


def _mean(
    values: Sequence[float] | np.ndarray, scenes: Sequence[Hashable], bounds: Bounds
) -> Interval:
    found = clustered_mean(values, scenes, bounds=bounds)
    return found.value, found.low, found.high


@lru_cache(maxsize=1)
def _resamples(count: int) -> np.ndarray:
    """Number of times that each resample draws each scene, (R, count)."""
    return np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), RESAMPLES)


def print_table(outcomes: Mapping[str, Sequence[Outcome]], title: str) -> None:
    """Prints one row per policy; ``closed`` is :func:`gap_closed`."""
    table = Table(title=title, box=box.SIMPLE_HEAD, pad_edge=False)  # fits 80 columns
    several = any(result.views > 1 for results in outcomes.values() for result in results)
    closed = REFERENCE_POLICY in outcomes and ORACLE in outcomes
    columns = ["policy", "ADD(-S)<0.1d", "min(ADD(-S)/d,1)", *(["closed"] if closed else [])]
    for column in [*columns, "travel", *(["views"] if several else []), "n"]:
        table.add_column(column, justify="left" if column == "policy" else "right")
    capped = {name: per_scene(rows, lambda r: r.capped) for name, rows in outcomes.items()}
    for policy, results in outcomes.items():
        (_, _, recall), _, (_, _, error), (_, _, travel), (_, _, views) = statistics(results)
        cells = [
            display_name(policy),
            f"{_with_interval(recall, 100, '.1f', '.0f')} %",
            _with_interval(error, 1, ".3f", ".3f"),
        ]
        if closed:
            share = gap_closed(capped[policy], capped[REFERENCE_POLICY], capped[ORACLE])
            cells.append("" if share is None or policy == STAY else f"{100 * share[0]:.0f} %")
        cells += [f"{travel[0]:.2f} m", *([f"{views[0]:.2f}"] if several else [])]
        table.add_row(*cells, str(len(capped[policy])))
    Console().print(table)


def _with_interval(interval: Interval, scale: float, value: str, end: str) -> str:
    """Formats a scaled value, and in brackets its interval."""
    mean, low, high = interval
    text = f"{scale * mean:{value}}"
    if low is None or high is None:
        return f"{text} ({TOO_FEW})"
    return f"{text} ({scale * low:{end}}-{scale * high:{end}})"


def display_name(name: str) -> str:
    """Name of a policy in tables and figures; of a file the name of its folder."""
    path = Path(name)
    return path.parent.name if path.suffix.lower() == ".safetensors" and path.parent.name else name
