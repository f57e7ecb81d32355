"""What came out of an evaluation, pair by pair, and the figures that sum it up.

Where somebody else's poses are scored, there is an outcome for each target instead, without what
only an estimator that runs here can tell: its keypoints and its time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .bop_results import BopResult
from .metrics import bootstrap_interval


@dataclass(frozen=True)
class Outcome:
    """One pair of views, estimated.

    Attributes:
        object_name: the target.
        error: ADD, or ADD-S for symmetric objects, in diameters; infinite without an estimate.
        keypoint_distance: mean distance of the 3D keypoints from the truth, m, where known.
        seconds: that the estimate took, where known.
        baseline: angle between the views as seen from the object, degrees; 0 for a single view.
        visibility: of the target in the reference view, 0 to 1.
        score: the detector's, in the reference view.
        gap: frames between the views, where they are of one sequence.
        estimate: the pose in the reference view, as result files have it.
        uncertainty: standard deviation of the keypoints that the estimator claims, m.
    """

    object_name: str
    error: float
    keypoint_distance: float | None
    seconds: float | None
    baseline: float
    visibility: float
    score: float
    gap: int | None = None
    estimate: BopResult | None = None
    uncertainty: float = 0.0


def summarise(outcomes: Sequence[Outcome], tags: Mapping[str, Any], seed: int = 0) -> list[dict]:
    """Records of the results file: each figure for each object, and the mean over the objects.

    A figure that is not known of every outcome is left out.
    """
    if not outcomes:
        raise ValueError("there is no pair of views with a target to evaluate")
    rng = np.random.default_rng(seed)
    names = list(dict.fromkeys(outcome.object_name for outcome in outcomes))
    figures: dict[str, tuple[str, Callable[[list[Outcome]], list[Any]]]] = {
        "add_s_recall": ("", lambda group: [float(o.error < 0.1) for o in group]),
        "add_over_diameter": ("", lambda group: [min(o.error, 1.0) for o in group]),
    }
    if all(o.keypoint_distance is not None for o in outcomes):
        figures["keypoint_distance"] = ("m", lambda group: [o.keypoint_distance for o in group])
    records: list[dict] = []
    for metric, (unit, values_of) in figures.items():
        by_object = {
            name: np.array(values_of([o for o in outcomes if o.object_name == name]))
            for name in names
        }
        for name, values in by_object.items():
            low, high = bootstrap_interval(values, rng)
            records.append(
                {"metric": metric, "value": float(values.mean()), "unit": unit, "object": name,
                 "low": low, "high": high, "n": len(values), **tags}
            )  # fmt: skip
        mean = float(np.mean([values.mean() for values in by_object.values()]))
        low, high = _interval_of_mean(list(by_object.values()), rng)
        records.append(
            {"metric": metric, "value": mean, "unit": unit, "object": "mean",
             "low": low, "high": high, "n": len(outcomes), **tags}
        )  # fmt: skip
    times = [o.seconds for o in outcomes if o.seconds is not None]
    if len(times) == len(outcomes):
        seconds = float(np.median(times))
        records.append({"metric": "seconds_per_pair", "value": seconds, "unit": "s", **tags})
    return records


def _interval_of_mean(
    groups: Sequence[np.ndarray], rng: np.random.Generator, resamples: int = 2000
) -> tuple[float, float]:
    """95 percent bootstrap interval of the mean over objects, resampled within each object."""
    means = [
        values[rng.integers(len(values), size=(resamples, len(values)))].mean(1)
        for values in groups
    ]
    low, high = np.quantile(np.mean(means, axis=0), [0.025, 0.975])
    return float(low), float(high)


def print_table(records: Sequence[Mapping[str, Any]], title: str, counted: str = "pairs") -> None:
    """Prints the figures of :func:`summarise` for people; ``counted`` says of what they are."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title)
    keypoints = any(record["metric"] == "keypoint_distance" for record in records)
    columns = ["object", "ADD(-S) < 0.1 d", "95 %", "ADD / d", *["keypoints"] * keypoints, counted]
    for column in columns:
        table.add_column(column, justify="left" if column == "object" else "right")
    cells: dict[str, dict[str, Mapping[str, Any]]] = {}
    for record in records:
        if "object" in record:
            cells.setdefault(str(record["object"]), {})[str(record["metric"])] = record
    for name, row in cells.items():
        recall = row["add_s_recall"]
        cells_of_row = [
            name,
            f"{100 * recall['value']:.1f} %",
            f"{100 * recall['low']:.0f} to {100 * recall['high']:.0f}",
            f"{row['add_over_diameter']['value']:.3f}",
        ]
        if keypoints:
            cells_of_row.append(f"{1000 * row['keypoint_distance']['value']:.1f} mm")
        cells_of_row.append(str(recall["n"]))
        table.add_row(*cells_of_row, style="bold" if name == "mean" else None)
    Console().print(table)
    for record in records:
        if record["metric"] == "seconds_per_pair":
            print(f"{1000 * record['value']:.0f} ms a pair (median)")
