"""Overlay images of wrong projections: the mask and the model, as written and as corrected."""

import io
import textwrap
from collections.abc import Iterable, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from ...core.files import write_atomically
from ...core.images import read_image
from ..visualization import outline
from .projection import Projection
from .projection_score import Evidence

MASK = "#19d3f3"
WRITTEN = "#ff3b30"
CORRECTED = "#ffd60a"


def draw_overlays(wrong: Iterable[Projection], folder: Path, count: int) -> list[Path]:
    """Writes at most ``count`` overlays into a folder; returns their paths.

    Raises:
        InputError: if an image cannot be decoded.
        OSError: if a file cannot be read or written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for projection in _choose(wrong, count):
        place, split = projection.place, projection.folder.parent.name
        name = f"{split}_{place.scene:06d}_{place.image:06d}_{place.annotation:02d}.png"
        _draw(projection, folder / name)
        paths.append(folder / name)
    return paths


def _choose(wrong: Iterable[Projection], count: int) -> list[Projection]:
    """Chooses at most ``count`` projections: all causes and objects in turn, most visible first."""
    groups: dict[tuple[str, int], list[Projection]] = {}
    for p in sorted(wrong, key=lambda p: -np.nan_to_num(p.evidence.visibility)):
        groups.setdefault((p.cause.name if p.cause else "", p.model.obj_id), []).append(p)
    turns = zip_longest(*groups.values())
    return [p for turn in turns for p in turn if p is not None][:count]


def _draw(projection: Projection, path: Path) -> None:
    """Writes one overlay as a PNG.

    Left: the model in the pose as written. Right: in the corrected pose, where a cause was found.
    Both panels show the mask, or the box where there is no mask.
    """
    from matplotlib.figure import Figure

    image = read_image(projection.image_path)
    readings = [("as written", WRITTEN, projection.T_cam_obj, projection.K)]
    if (cause := projection.cause) is not None:
        readings.append(("as corrected", CORRECTED, cause.T_cam_obj, cause.K))
    figure = Figure(figsize=(6 * len(readings), 5.4), dpi=100, layout="constrained")
    panels = figure.subplots(1, len(readings), squeeze=False)[0]
    shape = projection.evidence.shape
    outlines = [outline(projection.model, T, K, shape) for _, _, T, K in readings]
    frame = _frame(projection.evidence, [c for found in outlines for c in found])
    for panel, contours, (title, color, T, K) in zip(panels, outlines, readings, strict=True):
        panel.imshow(image)
        _draw_evidence(panel, projection.evidence)
        for contour in contours:
            closed = np.concatenate([contour, contour[:1]])
            panel.plot(*closed.T, color="black", linewidth=3.5)
            panel.plot(*closed.T, color=color, linewidth=2)
        named = "model" if contours else "model is not in the image"
        panel.plot([], [], color=color, linewidth=2, label=f"{named} {title}")
        score = projection.evidence.score(projection.model, T, K)
        panel.set_title(f"{title}: {100 * score:.0f} % match", fontsize=11)
        panel.set(xlim=frame[0], ylim=frame[1], xticks=[], yticks=[])
        panel.legend(loc="lower right", fontsize=9, framealpha=0.85)
    where = f"{projection.place}, object {projection.model.obj_id}"
    reason = textwrap.fill(cause.cause, 90) if cause else "no common mistake explains it"
    figure.suptitle(f"{where}\n{reason}", fontsize=12)
    content = io.BytesIO()
    figure.savefig(content, format="png")
    write_atomically(path, content.getvalue())


def _draw_evidence(panel: Any, evidence: Evidence) -> None:
    """Draws the mask as a tint, or the box."""
    left, top, right, bottom = evidence.box
    if evidence.mask is not None:
        tint = evidence.mask[..., None] * np.array([0.1, 0.83, 0.95, 0.55])
        extent = (left - 0.5, right + 0.5, bottom + 0.5, top - 0.5)
        panel.imshow(tint, extent=extent, interpolation="nearest")
        panel.plot([], [], color=MASK, linewidth=6, alpha=0.6, label="mask")
    else:
        label = "bbox_obj" if evidence.amodal else "bbox_visib"
        corners = [left, right, right, left, left], [top, top, bottom, bottom, top]
        panel.plot(*corners, color=MASK, linewidth=2, linestyle="--", label=label)


def _frame(
    evidence: Evidence, contours: Sequence[np.ndarray]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Returns limits of x and y around all that is drawn, at least a quarter of the image wide."""
    height, width = evidence.shape
    boxes = [np.concatenate([contour.min(axis=0), contour.max(axis=0)]) for contour in contours]
    boxes.append(evidence.box)
    stacked = np.clip(np.stack(boxes), 0, (width, height) * 2)
    low, high = stacked[:, :2].min(axis=0), stacked[:, 2:].max(axis=0)
    side = min(max(1.4 * max(high - low), width / 4), max(width, height))
    center = np.clip((low + high) / 2, side / 2, None)
    center = np.minimum(center, np.maximum((width, height) - np.array(side) / 2, side / 2))
    (left, top), (right, bottom) = center - side / 2, center + side / 2
    return (left - 0.5, min(right, width) - 0.5), (min(bottom, height) - 0.5, top - 0.5)
