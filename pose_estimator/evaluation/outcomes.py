"""The outcomes of an evaluation, pair by pair, and the results that summarize them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.errors import InputError
from ..bop.results import BopResult
from ..types import DepthUse
from .intervals import clustered_mean
from .metrics import CORRECT

MEASURES: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "add_s_recall": ("", lambda o: float(o.error < CORRECT)),
    "add_over_diameter": ("", lambda o: min(o.error, 1.0)),
    "keypoint_distance": ("m", lambda o: o.keypoint_distance),
}
"""Metric -> its unit, and its value for one outcome."""

_BOUNDED = ("add_s_recall", "add_over_diameter")
"""The metrics whose values are within 0 and 1."""


@dataclass(frozen=True)
class Outcome:
    """The result for one target in a pair of views, or in an image of a scored result file.

    Attributes:
        object_name: the target.
        error: ADD, or ADD-S for symmetric objects, in diameters; infinite without an estimate.
        keypoint_distance: mean error of the 3D keypoints, m; None for a result file.
        seconds: runtime; None for a result file.
        baseline: angle between the views at the object, degrees; 0 for a single view.
        visibility: of the target in the reference view, 0 to 1.
        score: detection confidence in the reference view.
        gap: frames between the views of a sequence.
        estimate: the pose in the reference view, as a row of a result file.
        uncertainty: predicted standard deviation of the keypoints, m.
        depth_use: what the depth map showed of the target, of methods with depth.
        scene_id: its scene, whose outcomes resemble each other; None: it is alone in its scene.
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
    scene_id: int | None = None
    depth_use: DepthUse | None = None


def summarize(outcomes: Sequence[Outcome], tags: Mapping[str, Any], seed: int = 0) -> list[dict]:
    """Returns records of each metric for each object, and of the mean over the objects.

    A metric that is not known for every outcome is left out. Records of too few outcomes for an
    interval have no ``low`` and ``high``.

    Raises:
        InputError: if there are no outcomes.
    """
    if not outcomes:
        raise InputError("there is no pair of views with a target to evaluate")
    names = list(dict.fromkeys(outcome.object_name for outcome in outcomes))
    records: list[dict] = []
    for metric, (unit, measure) in MEASURES.items():
        if any(measure(o) is None for o in outcomes):
            continue
        for name in [*names, "mean"]:
            rows = [o for o in outcomes if name in ("mean", o.object_name)]
            mean = clustered_mean(
                [measure(o) for o in rows],
                [(i if o.scene_id is None else "scene", o.scene_id) for i, o in enumerate(rows)],
                [o.object_name for o in rows],
                bounds=(0, 1) if metric in _BOUNDED else None,
                seed=seed,
            )
            ends = {} if mean.low is None else {"low": mean.low, "high": mean.high}
            records.append({"metric": metric, "value": mean.value, "unit": unit, "object": name}
                           | ends | {"n": mean.n, **tags})  # fmt: skip
    times = [o.seconds for o in outcomes if o.seconds is not None]
    if len(times) == len(outcomes):
        seconds = float(np.median(times))
        records.append({"metric": "seconds_per_pair", "value": seconds, "unit": "s", **tags})
    return records


def print_table(records: Sequence[Mapping[str, Any]], title: str, counted: str = "pairs") -> None:
    """Prints the records of :func:`summarize` as a table; ``counted`` names what ``n`` counts."""
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
            print(f"{1000 * record['value']:.0f} ms per pair (median)")
