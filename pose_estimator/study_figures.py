"""The study's charts, drawn from the records of results.json."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import METHODS
from .results import write_atomically
from .study_units import DEFAULT_WEIGHTS, NOISY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {
    "single": "#7a7f87",
    "early": "#e69f00",
    "late": "#56a4d9",
    "mid": "#c8401e",
    "rgbd": "#1b8a5a",
}
"""One for each method, in every chart and picture (after Okabe and Ito, for the colour-blind)."""

MARKERS = {"single": "v", "early": "s", "late": "D", "mid": "o", "rgbd": "^"}

INK = "#24292f"
GRID = "#d9dde2"

_COLUMNS = 5

Records = Sequence[Mapping[str, Any]]


def draw_charts(records: Records, folder: Path) -> dict[str, Path]:
    """Writes every chart that the records have figures for.

    Args:
        records: of results.json.
        folder: where the SVG files go.

    Returns:
        The files by what they show: ``recall_linemod``, ``recall_occlusion``, ``noise``.
    """
    made = {}
    for scene in ("linemod", "occlusion"):
        chosen = [
            r for r in records if r["metric"] == "keypoint_recall" and r.get("scene") == scene
        ]
        if chosen:
            made[f"recall_{scene}"] = save(
                recall_by_distance(chosen), folder / f"recall_{scene}.svg"
            )
    chosen = [r for r in records if r["metric"].startswith("noise_")]
    if chosen:
        made["noise"] = save(accuracy_under_noise(chosen), folder / "noise.svg")
    return made


def recall_by_distance(records: Records) -> Figure:
    """Figure 4: keypoint recall against camera distance, a panel for each object."""
    objects = [*sorted({r["object"] for r in records} - {"mean"}), "mean"]
    rows = -(-len(objects) // _COLUMNS)
    figure = new_figure(12.5, 2.15 * rows + 0.7)
    axes = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False)
    methods = [m for m in METHODS if any(r["method"] == m for r in records)]
    for axis, name in zip(axes.flat, objects, strict=False):
        for method in methods:
            points = sorted(
                (r["distance"], *_band(r, 100.0))
                for r in records
                if r["method"] == method and r["object"] == name
            )
            if points:
                x, y, low, high = zip(*points, strict=True)
                axis.fill_between(x, low, high, color=COLOURS[method], alpha=0.13, linewidth=0)
                axis.plot(
                    x, y, color=COLOURS[method], marker=MARKERS[method], markersize=3.5,
                    linewidth=1.6, label=method,
                )  # fmt: skip
        axis.set_title(
            "all objects" if name == "mean" else name,
            fontsize=10.5,
            fontweight="bold" if name == "mean" else "normal",
        )
        axis.set_ylim(-3, 103)
        tidy(axis)
    for axis in axes.flat[len(objects) :]:
        axis.set_visible(False)
    for column in range(_COLUMNS):
        shown = [axis for axis in axes[:, column] if axis.get_visible()]
        if shown:
            shown[-1].set_xlabel("camera distance (m)", fontsize=9)
            shown[-1].tick_params(labelbottom=True)
    for row in axes:
        row[0].set_ylabel("found (%)", fontsize=9)
    _legend(figure, axes.flat[len(objects) - 1])
    return figure


def accuracy_under_noise(records: Records) -> Figure:
    """Recall and keypoint distance against the error of the relative pose."""
    figure = new_figure(12.5, 6.4)
    axes = figure.subplots(2, 3, sharey="row", squeeze=False)
    titles = ("both together", "rotation alone", "translation alone")
    keeps = (
        lambda r: abs(r["rotation_deg"] / 2 - r["translation"] / 0.01) < 1e-9,
        lambda r: r["translation"] == 0,
        lambda r: r["rotation_deg"] == 0,
    )
    measures = (("noise_add_s_recall", 100.0, "ADD(-S) < 0.1 d (%)"),
                ("noise_keypoint_distance", 1000.0, "keypoint distance (mm)"))  # fmt: skip
    for (metric, scale, label), row in zip(measures, axes, strict=True):
        for column, (title, keep, axis) in enumerate(zip(titles, keeps, row, strict=True)):
            for method, training in _curves(records):
                points = sorted(
                    (
                        r["translation"] * 1000 if column == 2 else r["rotation_deg"],
                        *_band(r, scale),
                    )
                    for r in records
                    if r["metric"] == metric and r["method"] == method
                    and r["training"] == training and keep(r)
                )  # fmt: skip
                if not points:
                    continue
                x, y, low, high = zip(*points, strict=True)
                name = method if training == DEFAULT_WEIGHTS else f"{method}, trained with errors"
                style = "-" if training == DEFAULT_WEIGHTS else "--"
                axis.fill_between(x, low, high, color=COLOURS[method], alpha=0.1, linewidth=0)
                axis.plot(
                    x, y, style, color=COLOURS[method], marker=MARKERS[method], markersize=4,
                    linewidth=1.6, label=name,
                )  # fmt: skip
            axis.set_title(title if row is axes[0] else "", fontsize=10.5)
            tidy(axis)
            axis.set_xlabel(
                ("rotation (degrees), and 5 mm for each degree", "rotation (degrees)",
                 "translation (mm)")[column],
                fontsize=9,
            )  # fmt: skip
        row[0].set_ylim(bottom=0)  # last, since it ends the search for a fitting scale
        row[0].set_ylabel(label, fontsize=9)
    _legend(figure, axes[0][0])
    return figure


def _band(record: Mapping[str, Any], scale: float) -> tuple[float, float, float]:
    """Value, low and high end; a figure without an interval has a band of no width."""
    value = record["value"]
    ends = (value, record.get("low", value), record.get("high", value))
    return ends[0] * scale, ends[1] * scale, ends[2] * scale


def _curves(records: Records) -> list[tuple[str, str]]:
    """Methods and trainings in the order of the legend."""
    known = {(r["method"], r["training"]) for r in records}
    return [(m, t) for m in METHODS for t in (DEFAULT_WEIGHTS, NOISY) if (m, t) in known]


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches; no screen is needed and no global state is touched."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def tidy(axis: Axes) -> None:
    """A light grid, and no frame on the upper and right side."""
    axis.grid(True, color=GRID, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color("#8c959f")
    axis.tick_params(labelsize=8.5, color="#8c959f", labelcolor=INK)


def _legend(figure: Figure, axis: Axes) -> None:
    handles, labels = axis.get_legend_handles_labels()
    if handles:
        figure.legend(
            handles, labels, loc="outside upper center", ncols=len(labels), frameon=False,
            fontsize=10,
        )  # fmt: skip


def save(figure: Figure, path: Path) -> Path:
    """Writes a figure, an SVG or PNG by its suffix; the same figure gives the same bytes."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    kind = path.suffix[1:]
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    with rc_context({"svg.hashsalt": "two-view-pose"}):
        figure.savefig(buffer, format=kind, metadata=metadata, dpi=110)
    write_atomically(path, buffer.getvalue())
    return path
