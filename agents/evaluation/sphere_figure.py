"""View spheres from above: the true error of every candidate, and the policies' choices."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...core.plotting import INK, new_figure
from ...envs.observation import SpherePosition
from ...envs.view_banks.bank import ViewBank
from ..policies.registry import BASELINES
from .outcomes import ORACLE, REFERENCE_POLICY, Outcome, display_name

SCENES = 6
_MARKERS = ("o", "s", "D", "h")


def view_spheres(bank: ViewBank, outcomes: Mapping[str, Sequence[Outcome]]) -> Figure:
    """Plots ``SCENES`` scenes in which the choice matters, spread over the visibilities.

    The reference camera (blue) is at the bottom; the center of the half circle is straight above
    the object, the rim is the table's plane. A dot is a candidate view, red where it fails. The
    policies' choices are found from the errors of their ``outcomes``.
    """
    scenes = most_informative_scenes(bank)
    figure = new_figure(2.7 * len(scenes), 4.9)
    rows = figure.add_gridspec(2, len(scenes), height_ratios=(1.0, 0.62))
    policies = [REFERENCE_POLICY, *(name for name in outcomes if name not in BASELINES), ORACLE]
    names = [name for name in policies if name in outcomes][: len(_MARKERS)]
    for column, scene in enumerate(scenes):
        image = figure.add_subplot(rows[0, column])
        image.imshow(bank.first["image"][scene], interpolation="nearest")
        image.set_axis_off()
        name = bank.header.object_names[int(bank.object_index[scene])]
        image.set_title(
            f"{name}, {100 * bank.visibility[scene]:.0f} % visible", fontsize=10, color=INK
        )
        axis: Any = figure.add_subplot(rows[1, column], projection="polar")
        azimuth, elevation, reference = _candidate_angles(bank, scene)
        dots = _draw_sphere(axis, azimuth, elevation, bank.second_error[scene])
        axis.plot(0, 90 - np.degrees(reference), "o", color="#0969da", markersize=6, zorder=4)
        for marker, policy in zip(_MARKERS, names, strict=False):
            slot = slot_of_outcome(bank, scene, outcomes[policy][scene])
            if slot is not None:
                axis.plot(
                    azimuth[slot], 90 - np.degrees(elevation[slot]), marker, fillstyle="none",
                    color=INK, markersize=9 + 3 * _MARKERS.index(marker), markeredgewidth=1.2,
                    label=display_name(policy),
                )  # fmt: skip
    legend = axis.get_legend_handles_labels()
    columns = len(legend[1])
    figure.legend(*legend, loc="outside lower center", ncols=columns, frameon=False, fontsize=9)
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


def _candidate_angles(bank: ViewBank, scene: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Azimuth offsets (N,), elevations (N,), and the reference camera's elevation, radians."""
    center = bank.center[scene]
    first = SpherePosition.of(bank.T_cam_world[scene], center)
    views = [SpherePosition.of(T, center) for T in bank.second_T_cam_world[scene]]
    azimuth = np.array([view.azimuth for view in views]) - first.azimuth
    return azimuth, np.array([view.elevation for view in views]), first.elevation


def slot_of_outcome(bank: ViewBank, scene: int, outcome: Outcome) -> int | None:
    """Finds the candidate of an outcome by its error."""
    differences = np.abs(bank.second_error[scene] - outcome.add_over_diameter)
    slot = int(differences.argmin())
    return slot if differences[slot] < 1e-5 else None


def most_informative_scenes(bank: ViewBank) -> list[int]:
    """The scenes with the largest spread of errors, one per quantile bin of visibility."""
    order = np.argsort(bank.visibility, kind="stable")
    spread = np.minimum(bank.second_error, 0.3).std(axis=1)
    parts = np.array_split(order, min(SCENES, len(order)))
    return [int(part[np.argmax(spread[part])]) for part in parts]
