"""Figures of ``evaluate-agent``: recall, regret, and the chosen views on view spheres."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ...core.plotting import INK, new_figure, save, tidy
from ...envs.simulation.carrier import directions_from
from ...envs.view_banks.bank import ViewBank
from .outcomes import ORACLE, STAY, SUCCESS, Outcome, display_name
from .sphere_figure import view_spheres

PALETTE = ("#7a7f87", "#e69f00", "#56a4d9", "#1b8a5a", "#c8401e", "#8250df", "#24292f", "#b35900")
ANGLES = np.arange(0.0, 181.0, 15.0)
"""Bin edges of baseline angles, degrees."""

_MIN_VIEWS = 8


def draw_figures(
    folder: Path, outcomes: Mapping[str, Sequence[Outcome]], bank: ViewBank | None
) -> list[Path]:
    """Writes the figures of policies' outcomes on the same scenes; returns their paths."""
    paths = [save(recall_by_angle(outcomes, bank), folder / "recall_by_angle.svg")]
    if ORACLE in outcomes:
        paths.append(save(regrets(outcomes), folder / "regret.svg"))
    if bank is not None:
        paths.append(save(view_spheres(bank, outcomes), folder / "view_spheres.png"))
    return paths


def recall_by_angle(outcomes: Mapping[str, Sequence[Outcome]], bank: ViewBank | None) -> Figure:
    """Plots recall against the angle between the views, and each policy's mean."""
    figure = new_figure(7.2, 4.3)
    axis = figure.subplots()
    if bank is not None:
        angles, success = baseline_angles(bank)
        label = "all recorded views"
    else:
        moved = [r for name, results in outcomes.items() if name != STAY for r in results]
        angles = np.array([r.baseline_deg for r in moved])
        success = np.array([r.success for r in moved])
        label = "all policies' views"
    bin_of = np.digitize(angles, ANGLES) - 1
    bins = [b for b in range(len(ANGLES) - 1) if (bin_of == b).sum() >= _MIN_VIEWS]
    centers = [(ANGLES[b] + ANGLES[b + 1]) / 2 for b in bins]
    recalls = [100 * success[bin_of == b].mean() for b in bins]
    axis.plot(centers, recalls, color=INK, label=label)
    for number, (name, results) in enumerate(outcomes.items()):
        recall = 100 * float(np.mean([r.success for r in results]))
        color = PALETTE[number % len(PALETTE)]
        if name == STAY:
            axis.axhline(recall, color=color, linestyle=":", label=name)
            continue
        angle = float(np.mean([r.baseline_deg for r in results]))
        axis.plot(angle, recall, "o", color=color, markersize=8, label=display_name(name))
    axis.set_xlabel("angle between the views (degrees); for a policy its mean", fontsize=9)
    axis.set_ylabel("ADD(-S) < 0.1 d (%)", fontsize=9)
    axis.set_ylim(0, 103)
    tidy(axis)
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def baseline_angles(bank: ViewBank) -> tuple[np.ndarray, np.ndarray]:
    """Angles to the reference view in degrees, and successes, of all scenes and slots (M * N,)."""
    reference = directions_from(bank.center, bank.T_cam_world)[:, None]
    second = directions_from(bank.center[:, None], bank.second_T_cam_world)
    cosine = np.clip((reference * second).sum(axis=-1), -1, 1)
    return np.degrees(np.arccos(cosine)).ravel(), (bank.second_error < SUCCESS).ravel()


def regrets(outcomes: Mapping[str, Sequence[Outcome]]) -> Figure:
    """Plots the cumulative distribution of each policy's regret."""
    figure = new_figure(7.2, 4.3)
    axis = figure.subplots()
    best = np.array([r.capped for r in outcomes[ORACLE]])
    for number, (name, results) in enumerate(outcomes.items()):
        if name == ORACLE:
            continue
        regret = np.sort(np.array([r.capped for r in results]) - best)
        share = 100 * np.arange(1, len(regret) + 1) / len(regret)
        axis.plot(
            regret, share, color=PALETTE[number % len(PALETTE)], linewidth=1.6,
            label=f"{display_name(name)} ({regret.mean():.3f})",
        )  # fmt: skip
    axis.set_xscale("symlog", linthresh=0.01)
    axis.set_xlim(0, 1)
    axis.set_ylim(0, 101)
    axis.set_xlabel(
        "regret: capped ADD(-S)/d above the oracle's (in brackets the mean)", fontsize=9
    )
    axis.set_ylabel("scenes (%)", fontsize=9)
    tidy(axis)
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure
