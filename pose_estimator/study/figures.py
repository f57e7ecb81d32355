"""The study's charts, drawn from the records of results.json."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...core.plotting import new_figure, save, tidy
from ..methods import METHOD_TABLE
from . import published
from .plan import DEFAULT_WEIGHTS, NOISY, TESTS, has_both_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 5

Records = Sequence[Mapping[str, Any]]


def draw_charts(records: Records, folder: Path) -> dict[str, Path]:
    """Writes an SVG file for each chart that the records have results for.

    Returns:
        The files by name: ``recall_linemod``, ``recall_occlusion``, ``noise``.
    """
    recalls = [r for r in records if r["metric"] == "keypoint_recall"]
    by_test = {scene: [r for r in recalls if r["scene"] == scene] for scene in TESTS}
    charts = {f"recall_{scene}": recall_by_baseline(rs) for scene, rs in by_test.items() if rs}
    noise = [r for r in records if r["metric"].startswith("noise_")]
    if noise:
        charts["noise"] = accuracy_under_noise(noise)
    return {name: save(figure, folder / f"{name}.svg") for name, figure in charts.items()}


def recall_by_baseline(records: Records) -> Figure:
    """Draws Figure 4: keypoint recall by the distance between the cameras, an object a panel.

    The six objects of the paper's figure are marked with a star.
    """
    objects = [*sorted({r["object"] for r in records} - {"mean"}), "mean"]
    rows = -(-len(objects) // _COLUMNS)
    figure = new_figure(12.5, 2.15 * rows + 0.7)
    axes = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False)
    for axis, name in zip(axes.flat, objects, strict=False):
        for method, row in METHOD_TABLE.items():
            mine = [r for r in records if r["method"] == method and r["object"] == name]
            points = [(100 * r["baseline"], r) for r in mine]
            _plot(axis, points, 100.0, color=row.color, marker=row.marker, label=method)
        bold = "bold" if name == "mean" else "normal"
        title = "all objects" if name == "mean" else name + " *" * (name in published.FIGURE_4)
        axis.set_title(title, fontsize=10.5, fontweight=bold)
        axis.set_ylim(-3, 103)
        tidy(axis)
    for axis in axes.flat[len(objects) :]:
        axis.set_visible(False)
    for column in axes.T:
        shown = [axis for axis in column if axis.get_visible()]
        if shown:
            shown[-1].set_xlabel("distance between the cameras (cm)", fontsize=9)
            shown[-1].tick_params(labelbottom=True)
    for row in axes:
        row[0].set_ylabel("found (%)", fontsize=9)
    _legend(figure, axes.flat[len(objects) - 1])
    return figure


def accuracy_under_noise(records: Records) -> Figure:
    """Draws recall and keypoint distance against the error of the relative pose."""
    figure = new_figure(12.5, 6.4)
    axes = figure.subplots(2, 3, sharey="row", squeeze=False)
    columns: tuple[tuple[str, str, Callable, Callable], ...] = (
        ("both together", "rotation (degrees), and 5 mm for each degree",
         has_both_errors, lambda r: r["rotation_deg"]),
        ("rotation alone", "rotation (degrees)",
         lambda r: r["translation"] == 0, lambda r: r["rotation_deg"]),
        ("translation alone", "translation (mm)",
         lambda r: r["rotation_deg"] == 0, lambda r: 1000 * r["translation"]),
    )  # fmt: skip
    measures = (("noise_add_s_recall", 100.0, "ADD(-S) < 0.1 d (%)"),
                ("noise_keypoint_distance", 1000.0, "keypoint distance (mm)"))  # fmt: skip
    for (metric, scale, label), row in zip(measures, axes, strict=True):
        for axis, (title, x_label, keep, x) in zip(row, columns, strict=True):
            chosen = [r for r in records if r["metric"] == metric and keep(r)]
            for method, entry in METHOD_TABLE.items():
                for training, line in ((DEFAULT_WEIGHTS, "-"), (NOISY, "--")):
                    curve = (method, training)
                    points = [(x(r), r) for r in chosen if (r["method"], r["training"]) == curve]
                    name = f"{method}, trained with errors" if training else method
                    style = {"color": entry.color, "marker": entry.marker, "linestyle": line}
                    _plot(axis, points, scale, label=name, **style)
            if metric == measures[0][0]:
                axis.set_title(title, fontsize=10.5)
            tidy(axis)
            axis.set_xlabel(x_label, fontsize=9)
        row[0].set_ylim(bottom=0)  # last, because it ends autoscaling
        row[0].set_ylabel(label, fontsize=9)
    _legend(figure, axes[0][0])
    return figure


def _plot(
    axis: Axes, points: Iterable[tuple[float, Mapping[str, Any]]], scale: float, **style: Any
) -> None:
    """Plots results over x, if there are any, with the band of their intervals."""
    ordered = sorted(points, key=lambda point: point[0])
    if not ordered:
        return
    x = [x for x, _ in ordered]
    value, low, high = (
        [scale * record.get(end, record["value"]) for _, record in ordered]
        for end in ("value", "low", "high")
    )
    axis.fill_between(x, low, high, color=style["color"], alpha=0.12, linewidth=0)
    axis.plot(x, value, markersize=4, linewidth=1.6, **style)


def _legend(figure: Figure, axis: Axes) -> None:
    handles, labels = axis.get_legend_handles_labels()
    if handles:
        style: dict[str, Any] = {"loc": "outside upper center", "frameon": False, "fontsize": 10}
        figure.legend(handles, labels, ncols=len(labels), **style)
