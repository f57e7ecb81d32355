"""Outcomes of episodes, and the numbers that a results file says of them.

Policies see the same scenes, so they are compared scene by scene: an interval of a difference
resamples scenes, both policies' outcomes together (Efron and Tibshirani, *An Introduction to the
Bootstrap*, chapter 8).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

STAY = "stay"
"""The row for what the first view alone gives."""

ORACLE, REFERENCE_POLICY = "oracle", "max-baseline"
"""The best that any policy could do, and the rule that a trained one has to beat."""

SUCCESS = 0.1
"""An estimate is right if ADD(-S) is below this fraction of the object's diameter."""

VISIBILITY_BINS = ((0.0, 0.4), (0.4, 0.7), (0.7, 0.9), (0.9, 1.01))
"""Visible fractions of the target in the reference view, each up to but not including the next."""

RESAMPLES = 2000

Estimate = tuple[float, float, float]


@dataclass(frozen=True)
class Outcome:
    """The outcome of one episode.

    Attributes:
        object_name: the target.
        add_over_diameter: ADD(-S) of the final estimate over the object's diameter.
        travel: camera travel, meters.
        visibility: visible fraction of the target in the reference view; NaN where it is not known.
        baseline_deg: angle between the reference view and the newest.
        views: second views that were taken.
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
        """ADD(-S) over the diameter, 1 where it is more: what the reward counts."""
        return min(self.add_over_diameter, 1.0)

    @property
    def right(self) -> bool:
        """Whether ADD(-S) is below a tenth of the diameter."""
        return self.add_over_diameter < SUCCESS


def outcome_of(info: Mapping[str, Any], key: str, views: int) -> Outcome:
    """Reads the info of an environment; ``key`` is ``add_first`` or ``add_second``."""
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
    """The mean of a value in each scene, in the order of the scenes.

    Over a bank several seeds play the same scenes; these are not more scenes.
    """
    found: dict[Any, list[float]] = {}
    for number, result in enumerate(results):
        scene = number if result.scene is None else (result.object_name, result.scene)
        found.setdefault(scene, []).append(value(result))
    return np.array([np.mean(values) for values in found.values()])


def make_records(outcomes: Mapping[str, Sequence[Outcome]], scene: str) -> list[dict[str, Any]]:
    """The numbers of a results file, with 95 percent intervals over scenes.

    Over all objects (``object`` is ``mean``), for each object, and for each bin of visibility
    (``visibility`` is its lower end); then every policy against ``max-baseline``, scene by scene.
    """
    records = []
    for policy, results in outcomes.items():
        names = sorted({result.object_name for result in results})
        for name in ["mean", *names]:
            chosen = [result for result in results if name in ("mean", result.object_name)]
            records += _records(chosen, {"policy": policy, "scene": scene, "object": name})
        for low, high in VISIBILITY_BINS:
            chosen = [result for result in results if low <= result.visibility < high]
            tags = {"policy": policy, "scene": scene, "object": "mean", "visibility": low}
            records += _records(chosen, tags) if chosen else []
    return records + _comparisons(outcomes, scene)


def _records(results: Sequence[Outcome], tags: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            "metric": metric,
            "value": value,
            "unit": unit,
            **tags,
            "n": len(per_scene(results, lambda r: r.views)),
            "low": low,
            "high": high,
        }
        for metric, unit, (value, low, high) in statistics(results)
    ]


def statistics(results: Sequence[Outcome]) -> list[tuple[str, str, Estimate]]:
    """Metric, unit and (value, low, high) of each."""
    right = per_scene(results, lambda r: r.right)
    once = len(right) == len(results)
    means: list[tuple[str, str, Callable[[Outcome], float]]] = [
        ("add_over_diameter", "1", lambda r: r.add_over_diameter),
        ("capped_add_over_diameter", "1", lambda r: r.capped),
        ("travel", "m", lambda r: r.travel),
        ("second_views", "1", lambda r: r.views),
    ]
    return [
        ("add_s_recall", "1", _recall(right) if once else mean_interval(right)),
        *((metric, unit, mean_interval(per_scene(results, f))) for metric, unit, f in means),
    ]


def _comparisons(outcomes: Mapping[str, Sequence[Outcome]], scene: str) -> list[dict[str, Any]]:
    """Every policy against ``max-baseline``, and how much of its way to the oracle it has gone."""
    if REFERENCE_POLICY not in outcomes:
        return []
    capped = {name: per_scene(rows, lambda r: r.capped) for name, rows in outcomes.items()}
    right = {name: per_scene(rows, lambda r: r.right) for name, rows in outcomes.items()}
    reference, oracle = capped[REFERENCE_POLICY], capped.get(ORACLE)
    tags = {"scene": scene, "object": "mean", "against": REFERENCE_POLICY, "n": len(reference)}
    records = []
    for policy in outcomes:
        found = {
            "add_s_recall_difference": _paired(right[policy] - right[REFERENCE_POLICY]),
            "capped_difference": _paired(capped[policy] - reference),
        }
        if oracle is not None:
            closed = gap_closed(capped[policy], reference, oracle)
            found |= {"gap_closed": closed} if closed is not None else {}
            found["regret"] = _paired(capped[policy] - oracle)
        records += [
            {"metric": metric, "value": value, "unit": "1", "policy": policy, **tags,
             "low": low, "high": high}
            for metric, (value, low, high) in found.items()
        ]  # fmt: skip
    return records


def gap_closed(policy: np.ndarray, reference: np.ndarray, oracle: np.ndarray) -> Estimate | None:
    """Share of the gap in mean error from a reference policy to the oracle that a policy closes.

    Args:
        policy, reference, oracle: capped errors on the same scenes, (M,).

    Returns:
        Value and 95 percent interval; None where reference and oracle are the same.
    """
    gap = reference.mean() - oracle.mean()
    if gap < 1e-9:
        return None
    gaps, gains = (_resamples(len(policy)) @ (reference - other) for other in (oracle, policy))
    low, high = np.quantile(gains[gaps > 0] / gaps[gaps > 0], (0.025, 0.975))
    return float((reference.mean() - policy.mean()) / gap), float(low), float(high)


def _paired(differences: np.ndarray) -> Estimate:
    """A mean difference over scenes and its 95 percent interval."""
    means = _resamples(len(differences)) @ differences / len(differences)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(differences.mean()), float(low), float(high)


@lru_cache(maxsize=1)
def _resamples(count: int) -> np.ndarray:
    """How often each resample draws each scene, (R, count)."""
    return np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), RESAMPLES)


def _recall(right: np.ndarray) -> Estimate:
    """A fraction and its 95 percent interval (Wilson, 1927), which stays within 0 and 1."""
    result = binomtest(int(right.sum()), len(right))
    low, high = result.proportion_ci(method="wilson")
    return float(result.statistic), float(low), float(high)


def mean_interval(values: np.ndarray) -> Estimate:
    """A mean and its 95 percent interval by the normal approximation."""
    mean = float(values.mean())
    half = 1.959964 * float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else 0.0
    return mean, mean - half, mean + half


def print_table(outcomes: Mapping[str, Sequence[Outcome]], title: str) -> None:
    """Prints one row a policy; ``closed`` is the share of the gap from the rule to the oracle."""
    table = Table(title=title, box=box.SIMPLE_HEAD, pad_edge=False)  # it fits 80 columns
    several = any(result.views > 1 for results in outcomes.values() for result in results)
    closed = REFERENCE_POLICY in outcomes and ORACLE in outcomes
    columns = ["policy", "ADD(-S)<0.1d", "min(ADD(-S)/d,1)", *(["closed"] if closed else [])]
    for column in [*columns, "travel", *(["views"] if several else []), "n"]:
        table.add_column(column, justify="left" if column == "policy" else "right")
    capped = {name: per_scene(rows, lambda r: r.capped) for name, rows in outcomes.items()}
    for policy, results in outcomes.items():
        (_, _, recall), _, (_, _, error), (_, _, travel), (_, _, views) = statistics(results)
        cells = [
            short(policy),
            f"{100 * recall[0]:.1f} ({100 * recall[1]:.0f}-{100 * recall[2]:.0f}) %",
            f"{error[0]:.3f} ({error[1]:.3f}-{error[2]:.3f})",
        ]
        if closed:
            share = gap_closed(capped[policy], capped[REFERENCE_POLICY], capped[ORACLE])
            cells.append("" if share is None or policy == STAY else f"{100 * share[0]:.0f} %")
        cells += [f"{travel[0]:.2f} m", *([f"{views[0]:.2f}"] if several else [])]
        table.add_row(*cells, str(len(capped[policy])))
    Console().print(table)


def short(name: str) -> str:
    """What tables and figures call a policy: of a file the folder that it is in."""
    path = Path(name)
    return path.parent.name if path.suffix == ".safetensors" and path.parent.name else name
