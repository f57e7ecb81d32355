"""The tables of the report, from the study's records. A table without results is None."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..evaluation.intervals import TOO_FEW
from ..methods import METHODS, SOLVERS
from . import published
from .plan import BEST_GAP, DEFAULT_WEIGHTS, GAPS, has_both_errors
from .tables import VISIBILITIES

Records = Sequence[Mapping[str, Any]]
Record = Mapping[str, Any] | None

TESTS = {"linemod": "LineMOD-style", "occlusion": "Occlusion-style"}

REFINED = ("pnp", "mid-pnp")
"""Methods whose keypoints are those of a pose that was fitted to the votes of both views."""

PREDICTED = tuple(method for method in METHODS if method not in REFINED)
"""Methods whose own keypoints are measured."""

PAPER = ("early", "late", "mid", "REDE")
"""The columns of the paper's Table 1; REDE has depth."""

SYMMETRIC = ("eggbox", "glue")
"""Of LineMOD's objects."""

_FORMATS = {"mm": (1000.0, ".1f"), "%": (100.0, ".1f"), "points": (100.0, "+.1f")}
"""Unit -> scale and format: meters as mm, shares as percent or percentage points."""


@dataclass(frozen=True)
class Cell:
    """One cell: text (empty: a dash), interval in small print, bold if best, or of the paper."""

    text: str = ""
    interval: str = ""
    best: bool = False
    published: bool = False


@dataclass(frozen=True)
class Table:
    """A table: titles with the number of columns they span, heads, rows, paragraphs below."""

    groups: Sequence[tuple[str, int]]
    head: Sequence[Cell]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = ()
    last_is_mean: bool = False


def find(records: Records, **tags: Any) -> Record:
    """Returns the first record with these tags, or None."""
    return next((r for r in records if all(r.get(k) == v for k, v in tags.items())), None)


def keypoint_table(records: Records, scene: str) -> Table | None:
    """Table 1: mean distance of the predicted 3D keypoints by gap, mm."""
    methods, tags = [*PREDICTED, *REFINED], {"scene": scene}
    known = PAPER if scene == "linemod" else ()
    by_gap = {"metric": "keypoint_distance", "object": "mean", **tags}
    rows = []
    for gap in (*GAPS, "mean"):
        paper = published.keypoint_distances(gap) if known else {}
        cells = [
            *_ranked([find(records, **by_gap, method=m, gap=gap) for m in PREDICTED], "mm", min),
            *_ranked([find(records, **by_gap, method=m, gap=gap) for m in REFINED], "mm", min),
        ]
        theirs = [Cell(f"{1000 * paper[m]:g}" if m in paper else "", published=True) for m in known]
        rows.append([Cell(str(gap)), *cells, *theirs])
    notes = []
    for metric, title in (
        ("keypoint_distance_median", "Medians"),
        ("capped_keypoint_distance", "Means of distances capped at 100 mm"),
    ):
        results = {}
        for method in methods:
            found = [find(records, metric=metric, **tags, method=method, gap=gap) for gap in GAPS]
            if any(found):
                values = ", ".join(_format(record["value"], "mm") for record in found if record)
                results[method] = f"{method} {values}"
        if results:
            notes.append(f"{title} at gaps 1, 5 and 10: {'; '.join(results.values())} mm.")
    if not notes:
        return None
    groups = [
        ("", 1), ("ours, predicted", len(PREDICTED)), ("ours, from the votes", len(REFINED)),
        *([(f"published, {published.TESTS[scene]}", len(known))] if known else []),
    ]  # fmt: skip
    head = [*map(Cell, ("gap", *methods)), *(Cell(name, published=True) for name in known)]
    return Table(groups, head, rows, notes, last_is_mean=True)


def recall_table(records: Records, scene: str) -> Table | None:
    """Tables 2 and 3: ADD(-S) below a tenth of the diameter by object, percent."""
    at_best = [r for r in records if r.get("scene") == scene and r.get("gap") == BEST_GAP]
    recalls = [r for r in at_best if r["metric"] == "add_s_recall"]
    if not recalls:
        return None
    paper = published.recalls(scene)
    rows = []
    for name in [*sorted({r["object"] for r in recalls} - {"mean"}), "mean"]:
        results = [find(recalls, method=method, object=name) for method in METHODS]
        pairs = max(r["n"] for r in results if r is not None)
        theirs = paper.get(name, {}).get(published.OURS)
        cell = Cell("" if theirs is None else f"{theirs:.1f}", published=True)
        rows.append([Cell(_marked(name)), *_ranked(results, "%", max), cell, Cell(str(pairs))])
    gains: dict[str, list[str]] = {}
    for r in at_best:
        if r["metric"] == "add_s_recall_difference":
            interval = _interval(r, "points") or f"{TOO_FEW} for an interval"
            text = f"{_format(r['value'], 'points')} points over {r['against']} ({interval})"
            gains.setdefault(r["method"], []).append(text)
    notes = [f"{method}, pair by pair: {'; '.join(texts)}." for method, texts in gains.items()]
    notes.append("* symmetric: ADD-S, the mean distance of the nearest points, else ADD.")
    groups = [("", 1), ("ours, simulated", len(METHODS)), _paper_group(scene), ("", 1)]
    head = [*map(Cell, ("object", *METHODS)), Cell("mid", published=True), Cell("pairs")]
    return Table(groups, head, rows, notes, last_is_mean=True)


def published_table(scene: str) -> Table:
    """The paper's own Table 2 or 3: color images on the left, depth on the right."""
    paper = published.recalls(scene)
    names = list(paper["mean"])
    color = [name for name in names if "RGB-D" not in name]
    methods = [*color, *(name for name in names if name not in color)]
    rows = [
        [Cell(_marked(name)), *(Cell(f"{v:.1f}" if (v := row.get(m)) else "", published=True)
                                for m in methods)]
        for name, row in paper.items()
    ]  # fmt: skip
    groups = [("", 1), ("color images", len(color)), ("with depth", len(names) - len(color))]
    heads = [Cell(name.replace(" (RGB-D)", ""), published=True) for name in methods]
    return Table(groups, [Cell("object"), *heads], rows, last_is_mean=True)


def visibility_table(records: Records) -> Table | None:
    """Recall by the target's visible fraction, Occlusion-style test, percent."""
    chosen = [r for r in records if r["metric"] == "visibility_add_s_recall"]
    chosen = [r for r in chosen if r["scene"] == "occlusion"]
    rows = []
    for gap in GAPS:
        for low, high in VISIBILITIES:
            tags = {"gap": gap, "visibility": low}
            results = [find(chosen, method=method, **tags) for method in METHODS]
            if any(results):
                pairs = max(r["n"] for r in results if r is not None)
                name = f"gap {gap}, {100 * low:.0f} to {100 * min(high, 1):.0f} % visible"
                rows.append([Cell(name), *_ranked(results, "%", max), Cell(str(pairs))])
    groups = [("", 1), ("ours, simulated", len(METHODS)), ("", 1)]
    return Table(groups, [*map(Cell, ("", *METHODS, "pairs"))], rows) if rows else None


def solver_table(records: Records) -> Table | None:
    """Recall by solver, and the gain of Soft RANSAC."""
    rows = []
    for scene in ("occlusion", "linemod"):
        for method in METHODS:
            tags = {"scene": scene, "method": method, "gap": BEST_GAP}
            by_solver = {"metric": "solver_recall", **tags}
            results = [find(records, solver=s, **by_solver) for s in SOLVERS]
            gain = {"metric": "solver_recall_difference", **tags}
            cells = [_cell(find(records, against=s, **gain), "points") for s in SOLVERS[1:]]
            if any(results):
                name = Cell(f"{TESTS[scene]}, {method}")
                rows.append([name, *_ranked(results, "%", max), *cells])
    head = ["", *SOLVERS, *(f"over {solver}" for solver in SOLVERS[1:])]
    groups = [("", 1), ("solver", len(SOLVERS)), ("gain of soft, points", len(SOLVERS) - 1)]
    return Table(groups, [Cell(name) for name in head], rows) if rows else None


def noise_table(records: Records) -> Table | None:
    """Recall and keypoint distance under rotation and translation errors of the relative pose."""
    chosen = [r for r in records if r["metric"] == "noise_add_s_recall"]
    curves = sorted(
        {(r["method"], r["training"]) for r in chosen},
        key=lambda curve: (METHODS.index(curve[0]), curve[1] != DEFAULT_WEIGHTS),
    )
    levels = {(r["rotation_deg"], r["translation"]) for r in chosen if has_both_errors(r)}
    rows = []
    for rotation, translation in sorted(levels):
        row = [Cell(f"{rotation:g}°, {1000 * translation:g} mm")]
        tags: dict[str, Any] = {"rotation_deg": rotation, "translation": translation}
        for metric, unit, best, _ in _MEASURES:
            tags["metric"] = f"noise_{metric}"
            results = [find(records, method=m, training=t, **tags) for m, t in curves]
            row += _ranked(results, unit, best)
        rows.append(row)
    names = [m if t == DEFAULT_WEIGHTS else f"{m}, trained with {t}" for m, t in curves]
    groups = [("", 1), *((title, len(names)) for *_, title in _MEASURES)]
    head = [Cell(name) for name in ("error of the pose", *names, *names)]
    return Table(groups, head, rows) if rows else None


def training_table(records: Records) -> Table | None:
    """Recall and keypoint distance of other weights and the default ones, on the same pairs."""
    rows = []
    for record in records:
        training = record.get("training")
        if record["metric"] != "training_add_s_recall" or training == DEFAULT_WEIGHTS:
            continue
        tags = {name: record[name] for name in ("scene", "method", "gap")}
        row = [Cell(f"{training}, {TESTS[record['scene']]}, gap {record['gap']}")]
        for metric, unit, best, _ in _MEASURES:
            name = f"training_{metric}"
            baseline = find(records, metric=name, paired_with=training, **tags)
            other = find(records, metric=name, training=training, **tags)
            gain = find(records, metric=f"{name}_difference", training=training, **tags)
            cell = _cell(gain, "points" if unit == "%" else unit)
            row += [*_ranked([baseline, other], unit, best), cell]
        rows.append(row)
    groups = [("", 1), *((title, 3) for *_, title in _MEASURES)]
    head = [Cell(name) for name in ("weights, test", *["baseline", "other", "gain"] * 2)]
    return Table(groups, head, rows) if rows else None


def cost_table(records: Records) -> Table | None:
    """Milliseconds per pair."""
    chosen = [r for r in records if r["metric"] == "seconds_per_pair"]
    batches = sorted({r["batch"] for r in chosen})
    rows = []
    for method in METHODS:
        results = [find(chosen, method=method, batch=batch) for batch in batches]
        if any(results):
            texts = [f"{1000 * r['value']:.0f}" if r else "" for r in results]
            rows.append([Cell(method), *map(Cell, texts)])
    if not rows:
        return None
    threads = chosen[0]["threads"]
    groups = [("", 1), (f"ms a pair, {threads} thread{'s' * (threads != 1)}", len(batches))]
    return Table(groups, [Cell("method"), *(Cell(f"batch {b}") for b in batches)], rows)


_MEASURES: tuple[tuple[str, str, Callable[..., float], str], ...] = (
    ("add_s_recall", "%", max, "ADD(-S) < 0.1 d, %"),
    ("keypoint_distance", "mm", min, "keypoint distance, mm"),
)
"""Metric, display unit, what selects the best, and title."""


def _ranked(records: Sequence[Record], unit: str, best: Callable[..., float]) -> list[Cell]:
    """Makes the cells of one row; the best as displayed are bold, unless all are equal."""
    cells = [_cell(record, unit) for record in records]
    known = {float(cell.text) for cell in cells if cell.text}
    top = best(known) if len(known) > 1 else None
    return [replace(c, best=bool(c.text) and float(c.text) == top) for c in cells]


def _cell(record: Record, unit: str) -> Cell:
    """Makes the cell of a result with its interval."""
    if record is None:
        return Cell()
    missing = TOO_FEW if "n" in record else ""  # a median has none
    return Cell(_format(record["value"], unit), _interval(record, unit) or missing)


def _marked(name: str) -> str:
    """The name of an object; symmetric ones have a star."""
    return f"{name} *" if name in SYMMETRIC else name


def _paper_group(scene: str) -> tuple[str, int]:
    return f"published, {published.TESTS[scene]}", 1


def _format(value: float, unit: str) -> str:
    scale, spec = _FORMATS[unit]
    return format(scale * value, spec)


def _interval(record: Mapping[str, Any], unit: str) -> str:
    """Formats the interval of a record; empty if it has none."""
    if "low" not in record:
        return ""
    return f"{_format(record['low'], unit)} to {_format(record['high'], unit)}"
