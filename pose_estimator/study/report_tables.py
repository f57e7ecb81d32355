"""The tables of the report, from the study's records. A table without results is None."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from .. import METHODS
from . import published
from .plan import BEST_GAP, DEFAULT_WEIGHTS, GAPS, has_both_errors

Records = Sequence[Mapping[str, Any]]
Record = Mapping[str, Any] | None

TESTS = {"linemod": "LineMOD-style", "occlusion": "Occlusion-style"}

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
    """Table 1: mean 3D keypoint distance by gap, mm."""
    # Those that solve 3D keypoints for the pose, as the paper orders them.
    methods = [m for m in dict.fromkeys(("early", "mid", *METHODS)) if m != "single"]
    tags = {"metric": "keypoint_distance", "scene": scene, "object": "mean"}
    rows = []
    for gap in (*GAPS, "mean"):
        results = [find(records, **tags, method=method, gap=gap) for method in methods]
        paper = _paper_cell("keypoint_distance", scene, gap, "mm")
        rows.append([Cell(str(gap)), *_ranked(results, "mm", min), paper])
    medians = []
    tags = {"metric": "keypoint_distance_median", "scene": scene}
    for method in methods:
        found = [find(records, **tags, method=method, gap=gap) for gap in GAPS]
        if any(found):
            values = ", ".join(_format(record["value"], "mm") for record in found if record)
            medians.append(f"{method} {values}")
    groups = [("", 1), ("ours, simulated", len(methods)), _paper_group(scene)]
    head = [*map(Cell, ("gap", *methods)), Cell("mid", published=True)]
    note = f"Medians at gaps 1, 5 and 10: {'; '.join(medians)} mm."
    return Table(groups, head, rows, [note], last_is_mean=True) if medians else None


def recall_table(records: Records, scene: str) -> Table | None:
    """Tables 2 and 3: ADD(-S) below a tenth of the diameter by object, percent."""
    at_best = [r for r in records if r.get("scene") == scene and r.get("gap") == BEST_GAP]
    recalls = [r for r in at_best if r["metric"] == "add_s_recall"]
    if not recalls:
        return None
    rows = []
    paper = {"mean": _paper_cell("add_s_recall", scene, BEST_GAP, "%")}
    for name in [*sorted({r["object"] for r in recalls} - {"mean"}), "mean"]:
        results = [find(recalls, method=method, object=name) for method in METHODS]
        pairs = max(r["n"] for r in results if r is not None)
        cells = [*_ranked(results, "%", max), paper.get(name, Cell(published=True))]
        rows.append([Cell(name), *cells, Cell(str(pairs))])
    gains = [
        f"{_format(r['value'], 'points')} points over {r['against']} "
        f"({_interval(r, 'points') or 'no interval'})"
        for r in at_best
        if r["metric"] == "add_s_recall_difference"
    ]
    notes = [f"mid, pair by pair: {'; '.join(gains)}."] if gains else []
    gain = published.RESULTS.get(("add_s_recall_difference", scene, BEST_GAP))
    if gain is not None:
        notes.append(f"The paper's gain over rgbd: {_format(gain, 'points')} points.")
    notes.append(published.NO_RESULTS_BY_OBJECT)
    groups = [("", 1), ("ours, simulated", len(METHODS)), _paper_group(scene), ("", 1)]
    head = [*map(Cell, ("object", *METHODS)), Cell("mid", published=True), Cell("pairs")]
    return Table(groups, head, rows, notes, last_is_mean=True)


def solver_table(records: Records) -> Table | None:
    """Recall by solver, and the gain of Soft RANSAC."""
    rows = []
    for scene in ("occlusion", "linemod"):
        for method in METHODS:
            tags = {"scene": scene, "method": method, "gap": BEST_GAP}
            by_solver = {"metric": "solver_recall", **tags}
            results = [find(records, solver=s, **by_solver) for s in ("soft", "kabsch", "hard")]
            gain = {"metric": "solver_recall_difference", **tags}
            cells = [_cell(find(records, against=s, **gain), "points") for s in ("kabsch", "hard")]
            if any(results):
                name = Cell(f"{TESTS[scene]}, {method}")
                rows.append([name, *_ranked(results, "%", max), *cells])
    head = ["", "soft", "Kabsch", "hard", "soft over Kabsch", "soft over hard"]
    groups = [("", 1), ("solver", 3), ("gain, points", 2)]
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
        tags = {"scene": record["scene"], "method": record["method"]}
        row = [Cell(f"{training}, {TESTS[record['scene']]}")]
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
    return Cell(_format(record["value"], unit), _interval(record, unit))


def _paper_cell(metric: str, scene: str, gap: int | str, unit: str) -> Cell:
    """Makes the cell of Mid-Fusion's published result, empty if there is none."""
    value = published.RESULTS.get((metric, scene, gap))
    return Cell("" if value is None else _format(value, unit), published=True)


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
