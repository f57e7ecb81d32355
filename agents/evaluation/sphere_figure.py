"""View spheres seen from above: the true error of every candidate, and what policies chose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.plotting import INK, new_figure
from ...envs.observation import SpherePosition
from ...envs.view_banks.bank import ViewBank
from ..policies.registry import BASELINES
from .outcomes import ORACLE, REFERENCE_POLICY, Outcome, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCENES = 6
_MARKS = ("o", "s", "D", "h")


def view_spheres(
    bank: ViewBank, outcomes: Mapping[str, Sequence[Outcome]], count: int = SCENES
) -> Figure:
    """Scenes in which the choice mattered, spread over the visibilities.

    The reference camera (blue) is at the bottom; the middle of the half circle is straight above
    the object, the rim the table's plane. A dot is a candidate view, red where it fails.

    Args:
        bank: the recorded views.
        outcomes: of policies on its scenes, in order; their choices are found by the error.
        count: how many scenes.
    """
    scenes = most_informative_scenes(bank, count)
    figure = new_figure(2.7 * len(scenes), 4.9)
    rows = figure.add_gridspec(2, len(scenes), height_ratios=(1.0, 0.62))
    marked = [REFERENCE_POLICY, *(name for name in outcomes if name not in BASELINES), ORACLE]
    names = [name for name in marked if name in outcomes][: len(_MARKS)]
    for column, scene in enumerate(scenes):
        image = figure.add_subplot(rows[0, column])
        image.imshow(bank.first["image"][scene], interpolation="nearest")
        image.set_axis_off()
        name = bank.header.object_names[int(bank.object_index[scene])]
        image.set_title(
            f"{name}, {100 * bank.visibility[scene]:.0f} % visible", fontsize=10, color=INK
        )
        axis: Any = figure.add_subplot(rows[1, column], projection="polar")
        azimuth, elevation, reference = _places(bank, scene)
        dots = _draw_sphere(axis, azimuth, elevation, bank.second_error[scene])
        axis.plot(0, 90 - np.degrees(reference), "o", color="#0969da", markersize=6, zorder=4)
        for mark, policy in zip(_MARKS, names, strict=False):
            slot = _slot_of(bank, scene, outcomes[policy][scene])
            if slot is not None:
                axis.plot(
                    azimuth[slot], 90 - np.degrees(elevation[slot]), mark, fillstyle="none",
                    color=INK, markersize=9 + 3 * _MARKS.index(mark), markeredgewidth=1.2,
                    label=short(policy),
                )  # fmt: skip
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9
    )
    bar = figure.colorbar(dots, ax=figure.axes[1::2], shrink=0.8)
    bar.set_label("ADD(-S) / diameter", fontsize=9)
    return figure


def _draw_sphere(axis: Any, azimuth: np.ndarray, elevation: np.ndarray, error: np.ndarray) -> Any:
    """Draws candidate views at angles (N,) in radians, colored by error over diameter (N,)."""
    axis.set_theta_zero_location("S")
    axis.set_thetalim(-np.pi / 2 - 0.1, np.pi / 2 + 0.1)
    axis.set_rlim(0, 90)
    axis.set_rticks([20, 45, 70], labels=[])
    axis.set_xticks([])
    axis.grid(True, color="#e6e9ed")
    axis.spines["polar"].set_color("#d0d7de")
    return axis.scatter(
        azimuth, 90 - np.degrees(elevation), c=error, s=48, cmap="RdYlGn_r", vmin=0, vmax=0.3,
        zorder=3,
    )  # fmt: skip


def _places(bank: ViewBank, scene: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Azimuth from the reference camera's and elevation of every candidate, radians.

    Returns:
        Both (N,), and the elevation of the reference camera.
    """
    center = bank.center[scene]
    first = SpherePosition.of(bank.T_cam_world[scene], center)
    places = [SpherePosition.of(T, center) for T in bank.second_T_cam_world[scene]]
    azimuth = np.array([place.azimuth for place in places]) - first.azimuth
    return azimuth, np.array([place.elevation for place in places]), first.elevation


def _slot_of(bank: ViewBank, scene: int, outcome: Outcome) -> int | None:
    """The candidate that led to an outcome."""
    differences = np.abs(bank.second_error[scene] - outcome.add_over_diameter)
    slot = int(differences.argmin())
    return slot if differences[slot] < 1e-5 else None


def most_informative_scenes(bank: ViewBank, count: int) -> list[int]:
    """Scenes whose candidates differ most, one of each stretch of visibilities."""
    order = np.argsort(bank.visibility, kind="stable")
    spread = np.minimum(bank.second_error, 0.3).std(axis=1)
    parts = np.array_split(order, min(count, len(order)))
    return [int(part[np.argmax(spread[part])]) for part in parts]
