"""What the study must show, beside what it does show, computed from its records alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from .study_units import BEST_GAP, GAPS, NO_POSE_LOSS

Verdict = Literal["met", "met, unsure", "short, unsure", "short", "not measured"]
"""Unsure: the interval reaches to the other side of the bar."""


_WORST_FIRST: tuple[Verdict, ...] = (
    "short",
    "not measured",
    "short, unsure",
    "met, unsure",
    "met",
)


@dataclass(frozen=True)
class Criterion:
    """One line of the table.

    Attributes:
        what: the figure.
        paper: what the paper has, as text.
        bar: what it must be, as text.
        found: what it is, as text.
        verdict: whether it is.
    """

    what: str
    paper: str
    bar: str
    found: str
    verdict: Verdict


def find(records: Sequence[Mapping[str, Any]], **tags: Any) -> Mapping[str, Any] | None:
    """The first record with these tags, or None."""
    return next((r for r in records if all(r.get(k) == v for k, v in tags.items())), None)


def criteria(records: Sequence[Mapping[str, Any]]) -> list[Criterion]:
    """The bars of the study in their order.

    Args:
        records: of results.json; what is missing there counts as not measured.
    """
    at_best = {"gap": BEST_GAP, "object": "mean", "method": "mid"}
    distance = {"metric": "keypoint_distance", "scene": "linemod"}
    recall = {"metric": "add_s_recall", **at_best}
    gain = {"gap": BEST_GAP, "scene": "occlusion"}
    return [
        _bar(
            "mid, 3D keypoint distance, mean over gaps", "13 mm", 0.010, "mm",
            find(records, **{**at_best, **distance, "gap": "mean"}),
        ),
        _bar(
            f"mid, 3D keypoint distance, gap {BEST_GAP}", "7 mm", 0.005, "mm",
            find(records, **at_best, **distance),
        ),
        best_at_every_gap(records),
        _bar(
            f"mid, LineMOD-style, mean ADD(-S) < 0.1 d, gap {BEST_GAP}", "97.5 %", 0.975, "%",
            find(records, **recall, scene="linemod"),
        ),
        _bar(
            f"mid, Occlusion-style, mean ADD(-S) < 0.1 d, gap {BEST_GAP}", "66.6 %", 0.75, "%",
            find(records, **recall, scene="occlusion"),
        ),
        _bar(
            "mid over rgbd, Occlusion-style", "+2.4 points", 0.0, "points",
            find(
                records, metric="add_s_recall_difference", method="mid", against="rgbd", **gain
            ),
        ),
        _bar(
            "Soft RANSAC over Kabsch, mid, Occlusion-style", "better", 0.0, "points",
            find(
                records, metric="solver_recall_difference", method="mid", against="kabsch", **gain
            ),
        ),
        _bar(
            "mid, trained with the pose loss over without, LineMOD-style", "", 0.0, "points",
            find(
                records, metric="training_add_s_recall_difference", scene="linemod",
                training=NO_POSE_LOSS,
            ),
        ),
    ]  # fmt: skip


def best_at_every_gap(records: Sequence[Mapping[str, Any]]) -> Criterion:
    """Whether mid's keypoints are nearer than those of early and late, gap by gap."""
    what, paper, bar = "mid best of early, mid and late at every gap", "yes", "yes"
    found: list[str] = []
    verdicts: set[Verdict] = set()
    for gap in GAPS:
        for other in ("early", "late"):
            record = find(
                records, metric="keypoint_distance_difference", scene="linemod", method="mid",
                against=other, gap=gap,
            )  # fmt: skip
            if record is None:
                verdicts.add("not measured")
                continue
            low, high = ends(record)
            verdicts.add(_verdict(-record["value"], -high, -low, 0.0))
            if record["value"] >= 0:
                found.append(f"{other} is {1000 * record['value']:.1f} mm nearer at gap {gap}")
    worst = next(v for v in _WORST_FIRST if v in verdicts)
    text = f"no: {'; '.join(found)}" if found else "yes" if worst.startswith("met") else ""
    return Criterion(what, paper, bar, text, worst)


def _bar(
    what: str, paper: str, bar: float, unit: str, record: Mapping[str, Any] | None
) -> Criterion:
    """A distance must not be above its bar, a recall not below, a difference above zero."""
    sign = {"mm": "at most", "%": "at least", "points": "above"}[unit]
    must = f"{sign} {shown(bar, unit, 0 if unit == 'mm' else 1)}" if bar else "above 0"
    if record is None:
        return Criterion(what, paper, must, "", "not measured")
    value, low, high = record["value"], *ends(record)
    found = shown(value, unit)
    if "low" in record:
        found += f" ({interval(record, unit)})"
    if unit == "mm":
        return Criterion(what, paper, must, found, _verdict(-value, -high, -low, -bar))
    return Criterion(what, paper, must, found, _verdict(value, low, high, bar))


def _verdict(value: float, low: float, high: float, bar: float) -> Verdict:
    """How a figure that must be high, and its interval, stand to a bar."""
    # A difference of nothing at all is no gain.
    if value > bar or (value == bar and bar):
        return "met" if low >= bar else "met, unsure"
    return "short, unsure" if high > bar else "short"


def ends(record: Mapping[str, Any]) -> tuple[float, float]:
    """Low and high end of a record's interval; without one, anything may be."""
    return record.get("low", -math.inf), record.get("high", math.inf)


def interval(record: Mapping[str, Any], unit: str) -> str:
    """A record's interval for people, or empty text."""
    if "low" not in record:
        return ""
    return " to ".join(shown(record[end], unit, unit_too=False) for end in ("low", "high"))


def shown(value: float, unit: str, digits: int = 1, *, unit_too: bool = True) -> str:
    """A figure for people: metres as mm, shares as percent or as points of percent."""
    scale = {"mm": 1000.0, "%": 100.0, "points": 100.0}[unit]
    sign = "+" if unit == "points" else ""
    return f"{scale * value:{sign}.{digits}f}" + (f" {unit}" if unit_too else "")
