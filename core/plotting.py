"""Matplotlib figures without a screen, in one look."""

import io
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .files import write_atomically

INK = "#24292f"
GRID = "#d9dde2"


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, inches; needs no display and changes no global state."""
    return Figure(figsize=(width, height), layout="constrained")


def tidy(axis: Axes) -> None:
    """A light grid, without the top and right spines."""
    axis.grid(True, color=GRID, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    axis.spines[["left", "bottom"]].set_color("#8c959f")
    axis.tick_params(labelsize=8.5, color="#8c959f", labelcolor=INK)


def save(figure: Figure, path: Path) -> Path:
    """Writes a figure as SVG or PNG, by its suffix, with reproducible bytes."""
    buffer = io.BytesIO()
    kind = path.suffix[1:]
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    with rc_context({"svg.hashsalt": "two-view-pose"}):
        figure.savefig(buffer, format=kind, metadata=metadata, dpi=110)
    write_atomically(path, buffer.getvalue())
    return path
