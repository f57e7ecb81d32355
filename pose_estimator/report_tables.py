"""The tables of the study's page, from its records. A table without figures is empty text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from . import METHODS
from .criteria import find, interval, shown
from .published import published
from .report_html import Cell, Row, table
from .study_units import BEST_GAP, GAPS, TRAINED

Records = Sequence[Mapping[str, Any]]
Record = Mapping[str, Any] | None

PAPER_TEST = {"linemod": "real LineMOD", "occlusion": "real Occlusion LineMOD"}


def figure_cell(record: Record, unit: str, best: bool = False) -> Cell:
    """A figure with its interval below."""
    if record is None:
        return Cell()
    return Cell(shown(record["value"], unit, unit_too=False), interval(record, unit), best)


def ranked(records: Sequence[Record], unit: str, best: Callable[..., float]) -> list[Cell]:
    """Cells of one row, the best in bold unless all are equal, as they are shown."""
    values = [
        None if r is None else float(shown(r["value"], unit, unit_too=False)) for r in records
    ]
    known = {value for value in values if value is not None}
    top = best(known) if len(known) > 1 else None
    return [
        figure_cell(record, unit, value is not None and value == top)
        for record, value in zip(records, values, strict=True)
    ]


def keypoint_table(records: Records, scene: str) -> str:
    """Table 1: mean 3D keypoint distance by gap, mm."""
    methods = [m for m in ("early", "mid", "late", "rgbd") if m in METHODS]
    gaps: list[int | str] = [*GAPS, "mean"]
    found = {
        (method, gap): find(
            records, metric="keypoint_distance", scene=scene, method=method, object="mean", gap=gap
        )
        for method in methods
        for gap in gaps
    }
    if not any(found.values()):
        return ""
    rows: list[Row] = []
    for gap in gaps:
        cells = ranked([found[method, gap] for method in methods], "mm", min)
        paper = published("keypoint_distance", "mid", scene, gap=gap)
        rows.append(
            [
                "mean" if gap == "mean" else str(gap),
                *cells,
                Cell("" if paper is None else shown(paper, "mm", unit_too=False), style="paper"),
            ]
        )
    medians = []
    for method in methods:
        values = [
            f"{1000 * record['value']:.1f}"
            for gap in GAPS
            if (
                record := find(
                    records, metric="keypoint_distance_median", scene=scene, method=method, gap=gap
                )
            )
        ]
        if values:
            medians.append(f"{method} {', '.join(values)}")
    note = f'<p class="note">Medians at gaps 1, 5 and 10: {"; ".join(medians)} mm.</p>'
    head: Row = ["gap", *methods, Cell("mid", style="paper")]
    groups = [("", 1), ("ours, simulated", len(methods)), (f"published, {PAPER_TEST[scene]}", 1)]
    return table(head, rows, groups, last_is_mean=True) + note


def recall_table(records: Records, scene: str) -> str:
    """Tables 2 and 3: ADD(-S) below a tenth of the diameter by object, percent."""
    tags = {"metric": "add_s_recall", "scene": scene, "gap": BEST_GAP}
    chosen = [r for r in records if all(r.get(k) == v for k, v in tags.items())]
    if not chosen:
        return ""
    objects = sorted({r["object"] for r in chosen} - {"mean"})
    rows: list[Row] = []
    for name in [*objects, "mean"]:
        mine = [find(chosen, method=method, object=name) for method in METHODS]
        paper = published("add_s_recall", "mid", scene, object_name=name, gap=BEST_GAP)
        n = max(r["n"] for r in mine if r is not None)
        rows.append(
            [
                name,
                *ranked(mine, "%", max),
                Cell("" if paper is None else shown(paper, "%", unit_too=False), style="paper"),
                str(n),
            ]
        )
    head: Row = ["object", *METHODS, Cell("mid", style="paper"), "pairs"]
    groups = [
        ("", 1), ("ours, simulated", len(METHODS)), (f"published, {PAPER_TEST[scene]}", 1), ("", 1)
    ]  # fmt: skip
    gains = [
        f"{shown(r['value'], 'points')} over {r['against']} "
        f"({interval(r, 'points') or 'no interval'})"
        for r in records
        if r["metric"] == "add_s_recall_difference" and r["scene"] == scene and r["gap"] == BEST_GAP
    ]
    note = f'<p class="note">mid, pair by pair: {"; ".join(gains)}.</p>' if gains else ""
    if any(published("add_s_recall", "mid", scene, object_name=o, gap=BEST_GAP) is None
           for o in objects):  # fmt: skip
        note += (
            '<p class="note">Of the paper only the mean stands here: its figures by object are '
            "not in the sources that this page is made from.</p>"
        )
    return table(head, rows, groups, last_is_mean=True) + note


def solver_table(records: Records) -> str:
    """Recall by solver, and what Soft RANSAC gains."""
    rows: list[Row] = []
    for scene, title in (("occlusion", "Occlusion-style"), ("linemod", "LineMOD-style")):
        for method in METHODS:
            tags = {"scene": scene, "method": method, "gap": BEST_GAP}
            mine = [
                find(records, metric="solver_recall", solver=solver, **tags)
                for solver in ("soft", "kabsch", "hard")
            ]
            if any(mine):
                gains = [
                    find(records, metric="solver_recall_difference", against=other, **tags)
                    for other in ("kabsch", "hard")
                ]
                cells = [figure_cell(gain, "points") for gain in gains]
                rows.append([f"{title}, {method}", *ranked(mine, "%", max), *cells])
    if not rows:
        return ""
    head = ["", "soft", "Kabsch", "hard", "soft over Kabsch", "soft over hard"]
    return table(head, rows, [("", 1), ("solver", 3), ("gain, points", 2)])


def noise_table(records: Records) -> str:
    """Recall and keypoint distance under errors of the relative pose, both at once."""
    chosen = [r for r in records if r["metric"] == "noise_add_s_recall"]
    curves = sorted(
        {(r["method"], r["training"]) for r in chosen},
        key=lambda c: (METHODS.index(c[0]), c[1] != TRAINED),
    )
    levels = sorted(
        {
            (r["rotation_deg"], r["translation"])
            for r in chosen
            if abs(r["rotation_deg"] / 2 - r["translation"] / 0.01) < 1e-9
        }
    )
    if not curves:
        return ""
    rows: list[Row] = []
    for rotation, translation in levels:
        row: list[Cell | str] = [f"{rotation:g}°, {1000 * translation:g} mm"]
        for metric, unit, best in (
            ("noise_add_s_recall", "%", max),
            ("noise_keypoint_distance", "mm", min),
        ):
            row += ranked(
                [
                    find(
                        records, metric=metric, method=method, training=training,
                        rotation_deg=rotation, translation=translation,
                    )
                    for method, training in curves
                ],
                unit, best,
            )  # fmt: skip
        rows.append(row)
    names = [m if t == TRAINED else f"{m}, trained with {t}" for m, t in curves]
    groups = [
        ("", 1), ("ADD(-S) < 0.1 d, %", len(names)), ("keypoint distance, mm", len(names))
    ]  # fmt: skip
    return table(["error of the pose", *names, *names], rows, groups)


def training_table(records: Records) -> str:
    """What weights of other trainings reach, beside the usual ones on the same pairs."""
    chosen = [r for r in records if r["metric"] == "training_add_s_recall"]
    rows: list[Row] = []
    for record in chosen:
        if record["training"].startswith("usual"):
            continue
        tags = {"scene": record["scene"], "method": record["method"]}
        row: list[Cell | str] = [f"{record['training']}, {PAPER_NAMES[record['scene']]}"]
        for metric, unit, gain_unit in (
            ("training_add_s_recall", "%", "points"),
            ("training_keypoint_distance", "mm", "mm"),
        ):
            usual = find(records, metric=metric, training=f"usual, beside {record['training']}",
                         **tags)  # fmt: skip
            other = find(records, metric=metric, training=record["training"], **tags)
            gain = find(records, metric=f"{metric}_difference", training=record["training"], **tags)
            row += [
                *ranked([usual, other], unit, max if unit == "%" else min),
                figure_cell(gain, gain_unit),
            ]
        rows.append(row)
    if not rows:
        return ""
    head = ["weights, test", *["usual", "other", "gain"] * 2]
    return table(head, rows, [("", 1), ("ADD(-S) < 0.1 d, %", 3), ("keypoint distance, mm", 3)])


PAPER_NAMES = {"linemod": "LineMOD-style", "occlusion": "Occlusion-style"}


def cost_table(records: Records) -> str:
    """Milliseconds a pair."""
    chosen = [r for r in records if r["metric"] == "seconds_per_pair"]
    if not chosen:
        return ""
    batches = sorted({r["batch"] for r in chosen})
    rows: list[Row] = []
    for method in METHODS:
        mine = [find(chosen, method=method, batch=batch) for batch in batches]
        if any(mine):
            rows.append([method, *(f"{1000 * r['value']:.0f}" if r else "" for r in mine)])
    threads = chosen[0]["threads"]
    groups = [("", 1), (f"ms a pair, {threads} thread{'s' * (threads != 1)}", len(batches))]
    return table(["method", *(f"batch {b}" for b in batches)], rows, groups)
