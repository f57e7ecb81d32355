"""The picture of an episode: its first and its newest view, with the poses that were estimated."""

from __future__ import annotations

import numpy as np

from ..assets.object_model import ObjectModel
from ..pose_estimator.geometry import invert
from .episode import Episode
from .figure import Panel, comparison


def episode_figure(episode: Episode, model: ObjectModel) -> np.ndarray:
    """Draws the views of an episode with true and estimated outlines.

    Args:
        episode: with one view at least.
        model: of its target.

    Returns:
        RGB uint8, (664, 1360, 3).
    """
    first, newest = 0, len(episode.views) - 1
    panels = [_panel(episode, i) for i in dict.fromkeys((first, newest))]
    subtitle = f"{100 * episode.visibility:.0f} % visible in the reference view"
    return comparison(model, subtitle, panels[0], panels[1] if newest else None)


def _panel(episode: Episode, index: int) -> Panel:
    estimated = bool(episode.estimates)
    title, note = "Reference view", "pose from this view alone" if estimated else ""
    if index > 0:
        title = "Second view"
        note = f"{episode.baseline_deg:.0f}° from the first, camera moved {episode.travel:.2f} m"
    view = episode.views[index]
    relative = episode.cameras[index] @ invert(episode.cameras[0])
    return Panel(
        title,
        note,
        view.image,
        view.K,
        T_cam_obj_true=episode.T_cam_obj_true(index),
        T_cam_obj_estimate=relative @ episode.estimates[index].T_cam_obj if estimated else None,
        add=episode.errors[index] if estimated else None,
    )
